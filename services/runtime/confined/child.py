"""The child's side of `services/runtime/confined/running.py`: be shut in, work, say one last word, end.

**Conventions.** Nothing goes up the stack from here, which is the parent's; nothing of the parent's is finalised, since
its connections and files are shared.
"""

import errno
import gc
import os
import signal
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from typing import NoReturn

from services.runtime.confined.fences import let_go_of_descriptors, raise_fences
from services.runtime.confined.limits import Limits, take_on
from services.runtime.confined.words import (
    ANSWER,
    CRASH,
    FENCED,
    FLOODED,
    MACHINE,
    MEMORY,
    REFUSAL,
    TICK,
    say,
    texts_of,
    tick_of,
)
from services.runtime.parent_death import die_with
from stone.errors import StoneError

Progress = Callable[[str, int, int], None]

# What our limits and fences answer with; other errors of the system are the machine's.
OF_OUR_LIMITS = (errno.EFBIG, errno.EMFILE, errno.ENOMEM, errno.EPERM)


@dataclass(frozen=True)
class Answer:
    """The work, its limits, and where its words go."""

    work: Callable[[Progress], bytes]
    limits: Limits
    writing: int

    def told(self) -> tuple[int, bytes]:
        """The last word on the work: its kind and payload."""
        try:
            payload = self.work(self._tell)
            return (ANSWER, payload) if len(payload) <= self.limits.answer_bytes else (FLOODED, b"")
        except StoneError as error:
            leaf = type(error)
            return REFUSAL, texts_of(module=leaf.__module__, name=leaf.__qualname__, sentence=str(error))
        except MemoryError:
            return MEMORY, b""
        except OSError as error:
            return (CRASH if error.errno in OF_OUR_LIMITS else MACHINE), _exception(error)
        except BaseException as error:
            return CRASH, _exception(error)

    def _tell(self, stage: str, done: int, total: int) -> None:
        say(self.writing, TICK, tick_of(stage, done, total))


def live(answer: Answer, parent: int) -> NoReturn:
    """All that the child does."""
    status = 1
    try:
        die_with(parent)
        _forget_the_parent()
        let_go_of_descriptors(answer.writing)
        take_on(answer.limits)
        say(answer.writing, FENCED, texts_of(**raise_fences(answer.limits.folder)))
        say(answer.writing, *answer.told())
        status = 0
    finally:
        os._exit(status)


def _forget_the_parent() -> None:
    """Its garbage is not ours to finalise, its signals not ours to answer."""
    gc.freeze()
    signal.set_wakeup_fd(-1)
    for number in signal.valid_signals() - {signal.SIGKILL, signal.SIGSTOP}:
        if callable(signal.getsignal(number)):
            signal.signal(number, signal.SIG_DFL)
    signal.signal(signal.SIGXCPU, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_SETMASK, ())


def _exception(error: BaseException) -> bytes:
    """Its type for whoever asked; the text, which may quote anything, for the log of the operator."""
    return texts_of(exception=type(error).__name__, traceback=traceback.format_exc()[-1900:])
