"""Runs work on untrusted bytes in a forked, sandboxed child with limits of memory, CPU, files and time.

**Conventions.** In a service the child is forked from a process without secrets (`fork_server`), and its work is a
module's function of plain values; a process that has no fork server forks it from itself, and it sees everything of its
parent by copy. What it changes is gone with it, and of its errors only code and sentence come back. It has no network,
starts no process, signals nobody, reads no file but what it is given and the system's own, and writes none but below a
folder that it is given (`fences` says by which means and where those end); the parent's connections are not its own. It
dies with the thread that waits for it, and is reaped whatever happens: no orphan, no zombie, no descriptor stays. What
native code of the attacker's choice still could: answer with what it was given to read, in the form that the parent
believes.

What limits kill is a refusal and is not tried again: memory and processor are counted in the child alone, so the same
bytes would meet them again (`SandboxCrashedError`). A kill from outside, the wall clock and a failing disk say nothing
about the input: they are faults of the platform, tried again until the attempts are used up
(`SandboxInterruptedError`).

Kernels are compiled before: the child could not keep what it compiles, and would pay for it out of its limits.
"""

import os
import re
import select
import signal
import time
import warnings
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import structlog

from services.runtime.sandbox.child import ProgressCallback, SandboxTask, run_child
from services.runtime.sandbox.errors import SandboxCrashedError, SandboxInterruptedError
from services.runtime.sandbox.fences import NONE, SandboxMechanisms
from services.runtime.sandbox.folder_bounds import FolderWatch
from services.runtime.sandbox.fork_client import ForkServer, ServedChild, fork_server, single_task
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
from services.runtime.sandbox.system_files import system_files
from stone.errors import StoneError

CODE = re.compile(r"[A-Z]{3}-\d{3}|[a-z][a-z0-9_]{0,62}", re.ASCII)
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
Pipe = tuple[int, int]


class ForkedChild(Protocol):
    """A forked child, whoever forked it; `ended` is readable when there is something to be said of it."""

    begun_s: float | None

    @property
    def pid(self) -> int: ...

    @property
    def ended(self) -> int: ...

    def has_ended(self) -> bool: ...

    def reap(self) -> int: ...

    def close(self) -> None: ...


def sandboxed(work: Callable[[], bytes], limits: SandboxLimits = LIMITS, watch: SandboxWatch = UNWATCHED) -> bytes:
    """The answer of `work()`, run apart.

    Raises the `StoneError` that `work` raises (class, code and sentence; its facts stay behind), `SandboxCrashedError`,
    `SandboxInterruptedError`, and what `watch` raises.
    """
    return sandboxed_with_progress(partial(_without_progress, work), limits, watch)


def sandboxed_with_progress(
    work: Callable[[ProgressCallback], bytes], limits: SandboxLimits = LIMITS, watch: SandboxWatch = UNWATCHED
) -> bytes:
    """As `sandboxed`, for work that reports progress: `work(progress)`."""
    server = fork_server()
    begin = partial(_OwnChild, work, limits) if server is None else partial(_served, server, work, limits)
    with closing(SandboxProcess(begin, limits)) as child:
        return child.answer(watch)


def _served(
    server: ForkServer, work: Callable[[ProgressCallback], bytes], limits: SandboxLimits, pipe: Pipe
) -> ForkedChild:
    """A child of the fork server for this work alone."""
    task = single_task(limits, work)
    try:
        return ServedChild(server, task, pipe[1])
    finally:
        os.close(task)


def _without_progress(work: Callable[[], bytes], _progress: ProgressCallback) -> bytes:
    return work()


class _OwnChild:
    """A child that this process forked from itself."""

    def __init__(self, work: Callable[[ProgressCallback], bytes], limits: SandboxLimits, pipe: Pipe) -> None:
        reading, writing = pipe
        self.begun_s: float | None = time.monotonic()
        self._status: int | None = None
        parent = os.getpid()
        system_files()  # found once, not by every child
        self._pid = _forked()
        if self._pid == 0:
            os.close(reading)
            run_child(SandboxTask((work,), limits, writing), parent)
        self._ended = os.pidfd_open(self._pid)

    @property
    def pid(self) -> int:
        """Its number."""
        return self._pid

    @property
    def ended(self) -> int:
        """The descriptor that tells its end."""
        return self._ended

    def has_ended(self) -> bool:
        """Whether it has."""
        return bool(_readable([self._ended], 0))

    def reap(self) -> int:
        """Its wait status, having ended it where it has not ended by itself."""
        if self._status is None:
            os.kill(self._pid, signal.SIGKILL)  # a zombie takes this and keeps its status
            _, self._status = os.waitpid(self._pid, 0)
        return self._status

    def close(self) -> None:
        """Ended, and nothing of it left."""
        self.reap()
        os.close(self._ended)


class SandboxProcess:
    """A child and the pipe it speaks through, from its first moment to its reaping."""

    def __init__(self, begin: Callable[[Pipe], ForkedChild], limits: SandboxLimits) -> None:
        """`begin` answers with a child that writes into the pipe's second end."""
        reading, writing = os.pipe()
        self._limits, self._folder = limits, FolderWatch(limits)
        try:
            self.child = begin((reading, writing))
        except BaseException:
            os.close(reading)
            raise
        finally:
            os.close(writing)
        self._reading = reading
        os.set_blocking(reading, False)
        self._reader = SandboxMessageReader(reading, limits.answer_bytes)
        self._is_sound = False
        self._ticks = 0

    @property
    def is_waiting(self) -> bool:
        """Whether it answered what it was asked, and said nothing since."""
        return self._is_sound and self._reader.is_quiet and not _readable([self._reading], 0)

    def answer(self, watch: SandboxWatch) -> bytes:
        """What it says to the work that it was given last. Raises as `sandboxed`."""
        self._is_sound = False
        word = self._listen(watch)
        self._folder.look(self.child.pid)
        self._is_sound = word is not None and word.kind in (ANSWER, REFUSAL)
        return _answered(word, self, self._limits)

    def _listen(self, watch: SandboxWatch) -> SandboxMessage | None:
        """Its last word; None where it ended without one. Raises `SandboxInterruptedError` when time is up."""
        reader, asked_s = self._reader, time.monotonic()
        while True:
            _readable([self.child.ended, *([] if reader.is_closed else [self._reading])], GLANCE_MS)
            is_over = self.child.has_ended()  # what it said before is in the pipe then
            for word in reader.words():
                if word.kind == FENCED:
                    _note(word.texts())
                elif word.kind == TICK:
                    watch.progress(*self._tick(word))
                else:
                    return word
            if is_over:
                return None
            watch.on_poll()
            self._folder.look_at_times(self.child.pid)
            self._stop_when_late(asked_s)

    def _tick(self, word: SandboxMessage) -> tuple[str, int, int]:
        """Return the progress; if the child may quote nothing, only the number of its reports."""
        if self._limits.may_quote:
            return word.tick()
        self._ticks += 1
        return "", self._ticks, 0

    def close(self) -> None:
        """Ended and reaped, its pipe closed."""
        os.close(self._reading)
        self.child.close()

    def reap(self) -> int:
        """Its wait status, having ended it where it has not ended by itself."""
        return self.child.reap()

    def _stop_when_late(self, asked_s: float) -> None:
        begun_s = self.child.begun_s
        if begun_s is not None and time.monotonic() - max(begun_s, asked_s) > self._limits.wall_s:
            raise SandboxInterruptedError(f"took longer than {self._limits.wall_s:g} s of wall time")


def _readable(descriptors: list[int], within_ms: int) -> list[int]:
    """Those that have something to say, or whose other end is gone."""
    poller = select.poll()
    for descriptor in descriptors:
        poller.register(descriptor, select.POLLIN)
    return [descriptor for descriptor, _ in poller.poll(within_ms)]


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
    log.warning("sandbox fences are missing", **dict(known))


def _answered(word: SandboxMessage | None, child: SandboxProcess, limits: SandboxLimits) -> bytes:
    if word is None:
        raise _ended(child.reap(), limits)
    if word.kind == ANSWER:
        return word.payload
    if word.kind == REFUSAL and limits.may_quote:
        raise _refusal(word)
    if word.kind == MEMORY:
        raise SandboxCrashedError(f"needed more than {limits.memory_bytes >> 20} MiB")
    if word.kind == FLOODED:
        raise SandboxCrashedError(f"answered more than {limits.answer_bytes} bytes")
    said = word.texts()
    log.warning("sandboxed work raised", traceback=said.get("traceback", said.get("sentence", "")))
    raised = said.get("exception", "an error") if limits.may_quote else "an error"
    if word.kind == MACHINE:
        raise SandboxInterruptedError(f"failed on this machine with {raised}")
    raise SandboxCrashedError(f"raised {raised}")


def _ended(status: int, limits: SandboxLimits) -> StoneError:
    """The reason why the child ended without an answer."""
    code = os.waitstatus_to_exitcode(status)
    if code == -signal.SIGXCPU:
        return SandboxCrashedError(f"took longer than {limits.cpu_s} s of processor time")
    if code == -signal.SIGKILL:
        return SandboxInterruptedError("was killed from outside (out of memory?)")
    return SandboxCrashedError(f"was ended by {signal.Signals(-code).name}" if code < 0 else f"ended with code {code}")


def _refusal(word: SandboxMessage) -> StoneError:
    """The same class, code and sentence; the word is a stranger's, so this process must know the class."""
    said = word.texts()
    code = said.get("code", "")
    for leaf in _leaves(StoneError):
        if (leaf.__module__, leaf.__qualname__) == (said.get("module"), said.get("name")):
            if not CODE.fullmatch(code) or getattr(leaf, "code", code) != code:
                break
            error = leaf.__new__(leaf)
            StoneError.__init__(error, said.get("sentence", ""))
            error.code = code
            return error
    return SandboxCrashedError("sent an unknown refusal")


def _leaves(root: type[StoneError]) -> list[type[StoneError]]:
    return [found for leaf in root.__subclasses__() for found in (leaf, *_leaves(leaf))]
