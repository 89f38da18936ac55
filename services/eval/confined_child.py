"""The child's side of `services/eval/confined.py`: take the limits on, work, say one last word, end.

**Conventions.** Nothing goes up the stack from here, which is the parent's; nothing of the parent's is finalised, since
its connections and files are shared. Linux: the address space is read from `/proc/self/statm` (proc(5)).
"""

import ctypes
import errno
import gc
import os
import resource
import signal
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from itertools import count, islice
from pathlib import Path
from typing import NoReturn

from services.eval.confined_words import ANSWER, CRASH, FLOODED, MACHINE, MEMORY, REFUSAL, TICK, say, texts_of, tick_of
from services.runtime.parent_death import die_with
from stone.errors import StoneError

Progress = Callable[[str, int, int], None]

STATM, DESCRIPTORS = Path("/proc/self/statm"), "/proc/self/fd"
M_ARENA_MAX = -8  # mallopt(3)
# What the limits of files and descriptors answer with; other errors of the system are the machine's.
OF_OUR_LIMITS = (errno.EFBIG, errno.EMFILE, errno.ENOMEM)


@dataclass(frozen=True)
class Limits:
    """What the child may take: address space beyond the parent's, processor and wall time, files opened at once."""

    memory_bytes: int = 256 * 2**20
    cpu_s: int = 120
    wall_s: float = 1800.0
    answer_bytes: int = 64 * 2**20
    descriptors: int = 32


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
        _limit(answer.limits)
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


def _limit(limits: Limits) -> None:
    """No core is written: it would hold the ground truth. One arena: others reserve 64 MiB of the allowance each."""
    ctypes.CDLL(None).mallopt(M_ARENA_MAX, 1)
    taken = {int(name) for name in os.listdir(DESCRIPTORS)}
    free = islice((number for number in count() if number not in taken), limits.descriptors)
    held_bytes = int(STATM.read_text().split()[0]) * resource.getpagesize()
    _lower(resource.RLIMIT_NOFILE, max(free))  # it bounds the number of the next one, not how many there are
    _lower(resource.RLIMIT_FSIZE, 0)
    _lower(resource.RLIMIT_CORE, 0)
    _lower(resource.RLIMIT_CPU, limits.cpu_s, hard=limits.cpu_s + 1)
    _lower(resource.RLIMIT_AS, held_bytes + limits.memory_bytes)


def _lower(which: int, limit: int, *, hard: int | None = None) -> None:
    """Never above what holds already."""
    standing = resource.getrlimit(which)
    wished = (limit, limit if hard is None else hard)
    soft, most = (
        value if held == resource.RLIM_INFINITY else min(value, held)
        for value, held in zip(wished, standing, strict=True)
    )
    resource.setrlimit(which, (soft, most))


def _exception(error: BaseException) -> bytes:
    """Its type for whoever asked; the text, which may quote anything, for the log of the operator."""
    return texts_of(exception=type(error).__name__, traceback=traceback.format_exc()[-1900:])
