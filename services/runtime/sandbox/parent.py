"""Runs work on untrusted bytes in a forked, sandboxed child with limits of memory, CPU, files and time.

**Conventions.** In a service the child is forked from a process without secrets (`fork_server`), and its work is a
module's function with plain values. A process without a fork server forks the child itself, and the child has a copy of
its memory. Changes in the child end with it, and only code and sentence of its errors return.

The child has no network, starts no process, and signals none. It reads only its given files and the system's own, and
writes only below its given folder (`fences` documents mechanisms and limits). It has none of the parent's connections.
It dies with the thread that waits for it and is always reaped: no orphan, zombie or descriptor remains. An attacker's
native code could only send its readable data as an answer, in the form that the parent accepts.

Work killed by a limit is refused and not tried again: memory and processor time are counted in the child alone, so the
same bytes would exceed them again (`SandboxCrashedError`). A kill from outside, the wall clock and a failing disk are
no evidence against the input. They are faults of the platform, and the work is tried again while attempts are left
(`SandboxInterruptedError`).

Kernels are compiled beforehand: the child could not cache them, and compiling would count towards its limits.
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

    Both may raise: the child is then ended, and the exception propagates.
    """

    on_poll: Callable[[], None] = lambda: None
    progress: ProgressCallback = lambda stage, done, total: None


LIMITS, UNWATCHED = SandboxLimits(), SandboxWatch()
Pipe = tuple[int, int]


class ForkedChild(Protocol):
    """A forked child of either kind; `ended` is readable when there is news of its end."""

    begun_s: float | None

    @property
    def pid(self) -> int: ...

    @property
    def ended(self) -> int: ...

    def has_ended(self) -> bool: ...

    def reap(self) -> int: ...

    def close(self) -> None: ...


def sandboxed(work: Callable[[], bytes], limits: SandboxLimits = LIMITS, watch: SandboxWatch = UNWATCHED) -> bytes:
    """Run `work()` in a child and return its answer.

    Raise the `StoneError` that `work` raises (class, code and sentence, without its facts), `SandboxCrashedError`,
    `SandboxInterruptedError`, and the errors of `watch`.
    """
    return sandboxed_with_progress(partial(_without_progress, work), limits, watch)


def sandboxed_with_progress(
    work: Callable[[ProgressCallback], bytes], limits: SandboxLimits = LIMITS, watch: SandboxWatch = UNWATCHED
) -> bytes:
    """Do as `sandboxed`, for work that reports progress: `work(progress)`."""
    server = fork_server()
    begin = partial(_OwnChild, work, limits) if server is None else partial(_start_served, server, work, limits)
    with closing(SandboxProcess(begin, limits)) as child:
        return child.answer(watch)


def _start_served(
    server: ForkServer, work: Callable[[ProgressCallback], bytes], limits: SandboxLimits, pipe: Pipe
) -> ForkedChild:
    """Return a child of the fork server for this work alone."""
    task = single_task(limits, work)
    try:
        return ServedChild(server, task, pipe[1])
    finally:
        os.close(task)


def _without_progress(work: Callable[[], bytes], _progress: ProgressCallback) -> bytes:
    return work()


class _OwnChild:
    """A child that this process forked itself."""

    def __init__(self, work: Callable[[ProgressCallback], bytes], limits: SandboxLimits, pipe: Pipe) -> None:
        reading, writing = pipe
        self.begun_s: float | None = time.monotonic()
        self._status: int | None = None
        parent = os.getpid()
        system_files()  # cached here for all children
        self._pid = _fork()
        if self._pid == 0:
            os.close(reading)
            run_child(SandboxTask((work,), limits, writing), parent)
        self._reason_of_end = os.pidfd_open(self._pid)

    @property
    def pid(self) -> int:
        """The process ID."""
        return self._pid

    @property
    def ended(self) -> int:
        """The descriptor that signals its end."""
        return self._reason_of_end

    def has_ended(self) -> bool:
        """Return whether it has ended."""
        return bool(_poll([self._reason_of_end], 0))

    def reap(self) -> int:
        """Return the wait status, ending the child first if it still runs."""
        if self._status is None:
            os.kill(self._pid, signal.SIGKILL)  # a zombie accepts this and keeps its status
            _, self._status = os.waitpid(self._pid, 0)
        return self._status

    def close(self) -> None:
        """End the child and remove everything of it."""
        self.reap()
        os.close(self._reason_of_end)


class SandboxProcess:
    """A child and its message pipe, from its start to its reaping."""

    def __init__(self, begin: Callable[[Pipe], ForkedChild], limits: SandboxLimits) -> None:
        """Start a child by `begin`, which receives the pipe whose second end the child writes to."""
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
        """Whether it answered its work and has sent nothing since."""
        return self._is_sound and self._reader.is_quiet and not _poll([self._reading], 0)

    def answer(self, watch: SandboxWatch) -> bytes:
        """Return its answer to the last work. Raises as `sandboxed`."""
        self._is_sound = False
        word = self._listen(watch)
        self._folder.look(self.child.pid)
        self._is_sound = word is not None and word.kind in (ANSWER, REFUSAL)
        return _read_answer(word, self, self._limits)

    def _listen(self, watch: SandboxWatch) -> SandboxMessage | None:
        """Return its final message, None without one. Raises `SandboxInterruptedError` at the time limit."""
        reader, asked_s = self._reader, time.monotonic()
        while True:
            _poll([self.child.ended, *([] if reader.is_closed else [self._reading])], GLANCE_MS)
            is_over = self.child.has_ended()  # its earlier messages are then in the pipe
            for word in reader.words():
                if word.kind == FENCED:
                    _warn_of_missing(word.texts())
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
        """End and reap the child, and close its pipe."""
        os.close(self._reading)
        self.child.close()

    def reap(self) -> int:
        """Return the wait status, ending the child first if it still runs."""
        return self.child.reap()

    def _stop_when_late(self, asked_s: float) -> None:
        begun_s = self.child.begun_s
        if begun_s is not None and time.monotonic() - max(begun_s, asked_s) > self._limits.wall_s:
            raise SandboxInterruptedError(f"took longer than {self._limits.wall_s:g} s of wall time")


def _poll(descriptors: list[int], within_ms: int) -> list[int]:
    """Return the descriptors that are readable or whose other end is closed."""
    poller = select.poll()
    for descriptor in descriptors:
        poller.register(descriptor, select.POLLIN)
    return [descriptor for descriptor, _ in poller.poll(within_ms)]


def _fork() -> int:
    """Fork without Python 3.12's warning of forks beside threads; the child takes no lock that a thread may have."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        return os.fork()


def _warn_of_missing(fences: SandboxMechanisms) -> None:
    """Log a warning once per process if a fence is missing on this machine."""
    known = tuple(sorted(fences.items()))
    if NONE not in fences.values() or known in _NOTED or len(_NOTED) >= MOST_NOTED:
        return
    _NOTED.add(known)
    log.warning("sandbox fences are missing", **dict(known))


def _read_answer(word: SandboxMessage | None, child: SandboxProcess, limits: SandboxLimits) -> bytes:
    if word is None:
        raise _reason_of_end(child.reap(), limits)
    if word.kind == ANSWER:
        return word.payload
    if word.kind == REFUSAL and limits.may_quote:
        raise _make_refusal(word)
    if word.kind == MEMORY:
        raise SandboxCrashedError(f"needed more than {limits.memory_bytes >> 20} MiB")
    if word.kind == FLOODED:
        raise SandboxCrashedError(f"answered more than {limits.answer_bytes} bytes")
    texts = word.texts()
    log.warning("sandboxed work raised", traceback=texts.get("traceback", texts.get("sentence", "")))
    raised = texts.get("exception", "an error") if limits.may_quote else "an error"
    if word.kind == MACHINE:
        raise SandboxInterruptedError(f"failed on this machine with {raised}")
    raise SandboxCrashedError(f"raised {raised}")


def _reason_of_end(status: int, limits: SandboxLimits) -> StoneError:
    """Return the reason why the child ended without an answer."""
    code = os.waitstatus_to_exitcode(status)
    if code == -signal.SIGXCPU:
        return SandboxCrashedError(f"took longer than {limits.cpu_s} s of processor time")
    if code == -signal.SIGKILL:
        return SandboxInterruptedError("was killed from outside (out of memory?)")
    return SandboxCrashedError(f"was ended by {signal.Signals(-code).name}" if code < 0 else f"ended with code {code}")


def _make_refusal(word: SandboxMessage) -> StoneError:
    """Return an error of the same class, code and sentence. The message is untrusted: the class must exist here."""
    texts = word.texts()
    code = texts.get("code", "")
    for leaf in _list_subclasses(StoneError):
        if (leaf.__module__, leaf.__qualname__) == (texts.get("module"), texts.get("name")):
            if not CODE.fullmatch(code) or getattr(leaf, "code", code) != code:
                break
            error = leaf.__new__(leaf)
            StoneError.__init__(error, texts.get("sentence", ""))
            error.code = code
            return error
    return SandboxCrashedError("sent an unknown refusal")


def _list_subclasses(root: type[StoneError]) -> list[type[StoneError]]:
    return [descendant for leaf in root.__subclasses__() for descendant in (leaf, *_list_subclasses(leaf))]
