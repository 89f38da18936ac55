"""The child's side of the sandbox: isolate itself, answer each work, end.

**Conventions.** No exception leaves this module, since the stack above is the parent's. Nothing of the parent's is
finalised, since parent and child share connections and files.
"""

import errno
import gc
import os
import signal
import sys
import traceback
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from importlib import import_module
from typing import NoReturn

from services.runtime.processes.parent_death import die_with
from services.runtime.sandbox.fences import enter_sandbox, replace_inherited_descriptors
from services.runtime.sandbox.limits import SandboxLimits, apply_limits
from services.runtime.sandbox.messages import (
    ANSWER,
    CRASH,
    FENCED,
    FLOODED,
    MACHINE,
    MEMORY,
    REFUSAL,
    TICK,
    send_message,
    texts_of,
    tick_of,
)
from services.runtime.sandbox.own_user import leave_the_user
from stone.errors import StoneError

ProgressCallback = Callable[[str, int, int], None]

# Errors caused by our limits and fences; other errors of the system are the machine's.
OF_OUR_LIMITS = (errno.EFBIG, errno.EMFILE, errno.ENOMEM, errno.EPERM)


@dataclass(frozen=True)
class SandboxTask:
    """The works in order, their limits, the descriptor for messages, and that of works from a service."""

    works: Iterable[Callable[[ProgressCallback], bytes]]
    limits: SandboxLimits
    writing: int
    reading: int | None = None

    def run(self, work: Callable[[ProgressCallback], bytes]) -> tuple[int, bytes]:
        """Return the final message of a work: its kind and payload."""
        try:
            payload = work(self._tell)
            return (ANSWER, payload) if len(payload) <= self.limits.answer_bytes else (FLOODED, b"")
        except StoneError as error:
            leaf, sentence = type(error), str(error)
            return REFUSAL, texts_of(module=leaf.__module__, name=leaf.__qualname__, code=error.code, sentence=sentence)
        except MemoryError:
            return MEMORY, b""
        except OSError as error:
            return (CRASH if error.errno in OF_OUR_LIMITS else MACHINE), _describe_exception(error)
        except BaseException as error:
            return CRASH, _describe_exception(error)

    def _tell(self, stage: str, done: int, total: int) -> None:
        send_message(self.writing, TICK, tick_of(stage, done, total))


def run_child(answer: SandboxTask, parent: int) -> NoReturn:
    """Isolate this process, answer every work, and exit."""
    status = 1
    try:
        leave_the_user()
        die_with(parent)  # after the change of user, which would reset it
        _reset_parent_state()
        _import_first(answer)
        _disable_kernel_cache()
        replace_inherited_descriptors(answer.writing, answer.reading)
        apply_limits(answer.limits)
        send_message(answer.writing, FENCED, texts_of(**enter_sandbox(answer.limits)))
        for work in answer.works:
            send_message(answer.writing, *answer.run(work))
        status = 0
    finally:
        os._exit(status)


def _reset_parent_state() -> None:
    """Neither finalise the parent's garbage nor handle its signals."""
    gc.freeze()
    signal.set_wakeup_fd(-1)
    for number in signal.valid_signals() - {signal.SIGKILL, signal.SIGSTOP}:
        if callable(signal.getsignal(number)):
            signal.signal(number, signal.SIG_DFL)
    signal.signal(signal.SIGXCPU, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_SETMASK, ())


def _import_first(answer: SandboxTask) -> None:
    """Import the modules of the limits. A failure is no fault of the input, which is still unread."""
    sys.dont_write_bytecode = True
    try:
        for name in answer.limits.imports:
            import_module(name)
    except Exception as error:
        send_message(answer.writing, MACHINE, _describe_exception(error))
        raise


def _disable_kernel_cache() -> None:
    """Disable numba's cache: a kernel that a child adds to it would run in every worker."""
    caching = sys.modules.get("numba.core.caching")
    if caching is not None:
        caching.FunctionCache.save_overload = lambda *_: None


def _describe_exception(error: BaseException) -> bytes:
    """Return the type for the caller; the text, which may quote anything, is for the operator's log."""
    return texts_of(exception=type(error).__name__, traceback=traceback.format_exc()[-1900:])
