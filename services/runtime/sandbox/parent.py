"""Runs work on untrusted bytes in a forked, sandboxed child with limits of memory, CPU, files and time.

**Conventions.** The child sees everything of the parent by copy, so arguments cost nothing; what it changes is gone
with it, and of its errors only code and sentence come back. It has no network, starts no process, signals nobody and
writes no file but below a folder that it is given (`fences` says by which means and where those end); the parent's
connections are not its own. It dies with the thread that waits for it, and is reaped whatever happens: no orphan, no
zombie, no descriptor stays. What native code of the attacker's choice still could: read files and the copy of the
parent's memory, and answer with what it found there, in the form that the parent believes.

What limits kill is a refusal and is not tried again: memory and processor are counted in the child alone, so the same
bytes would meet them again (`SandboxCrashedError`). A kill from outside, the wall clock and a failing disk say nothing
about the input: they are faults of the platform, tried again until the attempts are used up
(`SandboxInterruptedError`).

Kernels are compiled before: the child could not keep what it compiles, and would pay for it out of its limits.
"""

import os
import select
import signal
import time
import warnings
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass

import structlog

from services.runtime.sandbox.child import ProgressCallback, SandboxTask, run_child
from services.runtime.sandbox.errors import SandboxCrashedError, SandboxInterruptedError
from services.runtime.sandbox.fences import NONE, SandboxMechanisms
from services.runtime.sandbox.limits import SandboxLimits
from services.runtime.sandbox.messages import (
    ANSWER,
    FENCED,
    FLOODED,
    MACHINE,
    MEMORY,
    REFUSAL,
    TICK,
    SandboxMessage,
    SandboxMessageReader,
)
from stone.errors import StoneError

GLANCE_MS = 200
MOST_NOTED = 16
_NOTED: set[tuple[tuple[str, str], ...]] = set()

log = structlog.get_logger(__name__)


@dataclass(frozen=True)
class SandboxWatch:
    """The parent's callbacks: `on_poll` is called at least five times a second, `progress` as the work reports.

    Either may raise: the child is then ended, and the exception goes on.
    """

    on_poll: Callable[[], None] = lambda: None
    progress: ProgressCallback = lambda stage, done, total: None


LIMITS, UNWATCHED = SandboxLimits(), SandboxWatch()


def sandboxed(work: Callable[[], bytes], limits: SandboxLimits = LIMITS, watch: SandboxWatch = UNWATCHED) -> bytes:
    """The answer of `work()`, run apart.

    Raises the `StoneError` leaf that `work` raises (code and sentence; its facts stay behind), `SandboxCrashedError`,
    `SandboxInterruptedError`, and what `watch` raises.
    """
    return sandboxed_with_progress(lambda _: work(), limits, watch)


def sandboxed_with_progress(
    work: Callable[[ProgressCallback], bytes], limits: SandboxLimits = LIMITS, watch: SandboxWatch = UNWATCHED
) -> bytes:
    """As `sandboxed`, for work that reports progress: `work(progress)`."""
    with closing(_SandboxProcess(work, limits)) as child:
        return _answered(child.listen(watch), child, limits)


class _SandboxProcess:
    """A forked process and the pipe it speaks through, from its first moment to its reaping."""

    def __init__(self, work: Callable[[ProgressCallback], bytes], limits: SandboxLimits) -> None:
        self.status: int | None = None
        self._reading, writing = os.pipe()
        self._begin_s, self._limits = time.monotonic(), limits
        parent = os.getpid()
        try:
            self._pid = _forked()
        except OSError:
            os.close(self._reading)
            os.close(writing)
            raise
        if self._pid == 0:
            os.close(self._reading)
            run_child(SandboxTask(work, limits, writing), parent)
        os.close(writing)
        os.set_blocking(self._reading, False)

    def listen(self, watch: SandboxWatch) -> SandboxMessage | None:
        """Its last word; None where it ended without one. Raises `SandboxInterruptedError` when time is up."""
        reader = SandboxMessageReader(self._reading, self._limits.answer_bytes)
        ended = os.pidfd_open(self._pid)
        try:
            while True:
                is_over = bool(_ready(ended, None if reader.is_closed else self._reading))
                for word in reader.words():
                    if word.kind == FENCED:
                        _note(word.texts())
                    elif word.kind == TICK:
                        watch.progress(*word.tick())
                    else:
                        return word
                if is_over:
                    return None
                watch.on_poll()
                self._stop_when_late()
        finally:
            os.close(ended)

    def close(self) -> None:
        """Ended and reaped, its pipe closed."""
        os.close(self._reading)
        self.reap()

    def reap(self) -> int:
        """Its wait status, having ended it where it has not ended by itself."""
        if self.status is None:
            os.kill(self._pid, signal.SIGKILL)  # a zombie takes this and keeps its status
            _, self.status = os.waitpid(self._pid, 0)
        return self.status

    def _stop_when_late(self) -> None:
        if time.monotonic() - self._begin_s > self._limits.wall_s:
            raise SandboxInterruptedError(f"took longer than {self._limits.wall_s:g} s of wall time")


def _ready(ended: int, reading: int | None) -> bool:
    """Wait a moment for a word or the end; whether it has ended (what it said before is in the pipe then)."""
    poller = select.poll()
    for descriptor in (ended, reading):
        if descriptor is not None:
            poller.register(descriptor, select.POLLIN)
    return ended in [descriptor for descriptor, _ in poller.poll(GLANCE_MS)]


def _forked() -> int:
    """Python 3.12 warns of forks beside threads; the child takes no lock that a thread may hold."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        return os.fork()


def _note(fences: SandboxMechanisms) -> None:
    """Warn once a process where a fence is missing on this machine; of whole fences nothing is said."""
    known = tuple(sorted(fences.items()))
    if NONE not in fences.values() or known in _NOTED or len(_NOTED) >= MOST_NOTED:
        return
    _NOTED.add(known)
    log.warning("sandbox is not wholly fenced", **dict(known))


def _answered(word: SandboxMessage | None, child: _SandboxProcess, limits: SandboxLimits) -> bytes:
    if word is None:
        raise _ended(child.reap(), limits)
    if word.kind == ANSWER:
        return word.payload
    if word.kind == REFUSAL:
        raise _refusal(word)
    if word.kind == MEMORY:
        raise SandboxCrashedError(f"needed more than {limits.memory_bytes >> 20} MiB")
    if word.kind == FLOODED:
        raise SandboxCrashedError(f"answered more than {limits.answer_bytes} bytes")
    said = word.texts()
    log.warning("sandboxed work raised", traceback=said.get("traceback", ""))
    if word.kind == MACHINE:
        raise SandboxInterruptedError(f"met {said.get('exception', 'an error')} of the machine")
    raise SandboxCrashedError(f"raised {said.get('exception', 'an error')}")


def _ended(status: int, limits: SandboxLimits) -> StoneError:
    """The reason why the child ended without an answer."""
    code = os.waitstatus_to_exitcode(status)
    if code == -signal.SIGXCPU:
        return SandboxCrashedError(f"took longer than {limits.cpu_s} s of processor time")
    if code == -signal.SIGKILL:
        return SandboxInterruptedError("was killed from outside (is the machine short of memory?)")
    return SandboxCrashedError(f"was ended by {signal.Signals(-code).name}" if code < 0 else f"ended with code {code}")


def _refusal(word: SandboxMessage) -> StoneError:
    """The same leaf with the same sentence; only leaves that this process knows, since the word is a stranger's."""
    said = word.texts()
    for leaf in _leaves(StoneError):
        if (leaf.__module__, leaf.__qualname__) == (said.get("module"), said.get("name")):
            error = leaf.__new__(leaf)
            StoneError.__init__(error, said.get("sentence", ""))
            return error
    return SandboxCrashedError("gave a refusal that nobody knows")


def _leaves(root: type[StoneError]) -> list[type[StoneError]]:
    return [found for leaf in root.__subclasses__() for found in (leaf, *_leaves(leaf))]
