"""The sandbox of a job's attempt: its folder, what it may read, its limits, progress and cancellation.

**Conventions.** The child maps recordings, so address space beyond memory is allowed for twice the size of what it
reads; temporary copies lie in the folder.
"""

import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from threading import Lock, Timer

import structlog

from services.runtime.jobs.specs import Attempt
from services.runtime.sandbox.child import ProgressCallback
from services.runtime.sandbox.errors import SandboxCrashedError, SandboxInterruptedError
from services.runtime.sandbox.folder_bounds import give_back
from services.runtime.sandbox.fork_client import ForkServer, ServedChild, fork_server, warm_unless_served
from services.runtime.sandbox.fork_server import Work, parcel
from services.runtime.sandbox.limits import SandboxLimits
from services.runtime.sandbox.parent import Pipe, SandboxProcess, SandboxWatch, sandboxed_with_progress
from services.runtime.settings import Settings

MEMORY_BYTES = 4 * 2**30
ANSWER_BYTES = 128 * 2**20
DESCRIPTORS = 2048  # a bag may be split into many files, each of them open
SLACK_BYTES = 2**30
# The files a job may leave: for the smallest recording, and more for each byte that it reads (labels compress well).
FOLDER_FILES, FOLDER_BYTES = 200_000, 64 * 2**30
BYTES_A_FILE, BYTES_A_BYTE = 4096, 64

SandboxedWork = Callable[[Path, ProgressCallback], bytes]


@dataclass(frozen=True)
class JobSandbox:
    """Where a job's work is done, what it reads (files, and whatever is below folders), for whom.

    `warm` compiles the kernels that it needs, where no fork server has done so. `temporary`, within the folder unless
    it is the folder, is where temporary files go. With `shares_run` the folder and all that is read are the run's, and
    its jobs may share a child.
    """

    folder: Path
    reads: tuple[Path, ...]
    attempt: Attempt
    settings: Settings
    warm: Callable[[], None]
    temporary: Path | None = None
    makes_links: bool = False
    shares_run: bool = False

    @property
    def limits(self) -> SandboxLimits:
        limit_s = self.settings.jobs.time_limit_s
        read_bytes = sum(path.stat().st_size for path in self.reads)
        folder_bytes = FOLDER_BYTES + BYTES_A_BYTE * read_bytes
        return SandboxLimits(
            memory_bytes=MEMORY_BYTES,
            cpu_s=2 * int(limit_s),  # hashing and reading go side by side
            wall_s=limit_s,
            answer_bytes=ANSWER_BYTES,
            descriptors=DESCRIPTORS,
            mapped_bytes=SLACK_BYTES + 2 * read_bytes,
            folder=self.folder,
            file_bytes=min(self.settings.uploads.max_bytes, folder_bytes),
            reads=self.reads,
            makes_links=self.makes_links,
            folder_files=FOLDER_FILES + read_bytes // BYTES_A_FILE,
            folder_bytes=folder_bytes,
        )

    def run(self, work: SandboxedWork, stage: str, total: int) -> bytes:
        """The answer of `work(folder, progress)`. Raises as `sandboxed_with_progress`, and `JobCancelledError`."""
        warm_unless_served(self.warm)
        temporary = self.temporary or self.folder
        task = partial(_work, self.folder, str(temporary), work)
        watch = sandbox_watch_of(self.attempt, stage, total)
        try:
            if self.shares_run:
                return sandboxed_in_run(RunWork(self.attempt.root_id, task, self.limits, watch))
            CHILDREN.close()  # one child at a time
            return sandboxed_with_progress(task, self.limits, watch)
        finally:
            give_back(self.folder)


@contextmanager
def private_folder_in(parent: Path) -> Iterator[Path]:
    """A fresh hidden folder below `parent`; it goes with whatever is left in it."""
    parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".apart-", dir=parent) as folder:
        yield Path(folder).resolve()


def _work(folder: Path, temporary: str, work: SandboxedWork, progress: ProgressCallback) -> bytes:
    """The child's part."""
    tempfile.tempdir = temporary
    return work(folder, progress)


def sandbox_watch_of(attempt: Attempt, stage: str, total: int) -> SandboxWatch:
    """What the child says is passed on; while it says nothing, what it said last: so the wish to stop is heard."""
    last = [(stage, 0, total)]

    def told(stage: str, done: int, total: int) -> None:
        last[0] = (stage, done, total)
        attempt.progress(*last[0])

    return SandboxWatch(on_poll=lambda: attempt.progress(*last[0]), progress=told)


# A sandboxed child that is kept for the next job of the same run, which then forks nothing and finds its memory there.
#
# **Conventions.** A process keeps one child at most, for one run of one sequence of one owner. Another run's job ends
# it, so no child ever sees two runs; so does one that shares no child, or needs more than this one was given, since
# fences are never widened. What it was given is the run's own folder to write in and the run's own recording to read:
# who takes a child over by a recording reads and writes what the jobs of that run may anyway, and can spoil the labels
# of that recording alone.
#
# It is ended when it was idle for `IDLE_S`, breaks, is told to stop, says what it was not asked, holds or has used
# much; and it ends with its process, as any child does. Each job has its own wall time; of processor time all that it
# is allowed, and at most `MOST_USED_S` more; of memory what the child has beyond what it kept. So what breaks in a
# child that did other jobs before may be their doing: a fresh one is asked before anything is said of the input. A
# kill from outside costs the attempt, as ever (`services/runtime/sandbox/parent.py`).


IDLE_S = 5.0
MOST_HELD_BYTES = 2**30
MOST_USED_S = 300
BY_READ = ("mapped_bytes", "file_bytes", "folder_files", "folder_bytes")  # limits that grow with the bytes read
LONGEST_BYTES = 2**15  # of a work: a pipe that nobody reads takes it all the same

log = structlog.get_logger(__name__)


@dataclass(eq=False)
class RunChild:
    """A child of a run, its limits, and the pipe by which it is told its works."""

    run_id: str
    limits: SandboxLimits
    process: SandboxProcess
    served: ServedChild
    works: int
    inodes: tuple[tuple[int, int], ...]
    timer: Timer | None = None

    def answer(self, work: Work, watch: SandboxWatch) -> bytes:
        """Raises as `sandboxed`."""
        try:
            os.write(self.works, parcel(work))
        except BrokenPipeError:
            raise SandboxInterruptedError("ended between two jobs") from None
        return self.process.answer(watch)

    def is_worth_keeping(self) -> bool:
        """Whether another job may have it."""
        used = self.served.note_usage()
        return self.process.is_waiting and used.cpu_s < MOST_USED_S and used.held_bytes < MOST_HELD_BYTES

    def serves(self, run_id: str, limits: SandboxLimits) -> bool:
        """Whether it waits, and was given all that a job of these limits needs, and as much of the rest."""
        given = {name: getattr(self.limits, name) for name in BY_READ}
        is_enough = all(getattr(limits, name) <= most for name, most in given.items())
        is_enough = is_enough and set(limits.reads) <= set(self.limits.reads)
        is_alike = replace(limits, reads=self.limits.reads, **given) == self.limits
        is_theirs = self.run_id == run_id and is_enough and is_alike
        return is_theirs and self.inodes == _inodes(self.limits) and self.process.is_waiting

    def close(self) -> None:
        """Ended, and nothing of it left."""
        os.close(self.works)
        self.process.close()


def begun_child(server: ForkServer, run_id: str, limits: SandboxLimits) -> RunChild:
    """A fresh child of the run."""
    inodes = _inodes(limits)
    reading, works = os.pipe()
    begun = list[ServedChild]()

    def begin(pipe: Pipe) -> ServedChild:
        begun.append(ServedChild(server, reading, pipe[1]))
        return begun[0]

    try:
        os.write(works, parcel(replace(limits, cpu_s=limits.cpu_s + MOST_USED_S)))
        process = SandboxProcess(begin, limits)
    except BaseException:
        os.close(works)
        raise
    finally:
        os.close(reading)
    return RunChild(run_id, limits, process, begun[0], works, inodes)


def _inodes(limits: SandboxLimits) -> tuple[tuple[int, int], ...]:
    """What its fences let through: files, not names of files that others may have taken since."""
    found = (os.stat(path) for path in (*limits.reads, *([limits.folder] if limits.folder else [])) if path.exists())
    return tuple((one.st_dev, one.st_ino) for one in found)


@dataclass(frozen=True)
class RunWork:
    """Work for a child of this run."""

    run_id: str
    work: Work
    limits: SandboxLimits
    watch: SandboxWatch


@dataclass(eq=False)
class RunChildren:
    """The child that this process keeps while it waits for its next job."""

    _kept: RunChild | None = None
    _lock: Lock = field(default_factory=Lock)

    def answer(self, server: ForkServer, asked: RunWork) -> bytes:
        """Raises as `sandboxed`."""
        kept = self._taken(asked)
        if kept is not None:
            try:
                return self._answer(kept, asked)
            except SandboxCrashedError as error:
                log.warning("a reused child broke: the job runs again in a fresh child", fate=error.fate)
        return self._answer(begun_child(server, asked.run_id, asked.limits), asked)

    def close(self) -> None:
        """End the child that is kept, if one is."""
        with self._lock:
            kept, self._kept = self._kept, None
        if kept is not None:
            kept.close()

    def _answer(self, child: RunChild, asked: RunWork) -> bytes:
        try:
            return child.answer(asked.work, asked.watch)
        finally:
            if child.is_worth_keeping():
                self._keep(child)
            else:
                child.close()

    def _taken(self, asked: RunWork) -> RunChild | None:
        """The child that is kept, if it serves; one that does not is ended."""
        with self._lock:
            kept, self._kept = self._kept, None
        if kept is None:
            return None
        if kept.timer is not None:
            kept.timer.cancel()
        if kept.serves(asked.run_id, asked.limits):
            return kept
        kept.close()
        return None

    def _keep(self, child: RunChild) -> None:
        """Until the next job, or not much longer."""
        self.close()
        child.timer = Timer(IDLE_S, self._drop, (child,))
        child.timer.daemon = True
        with self._lock:
            self._kept = child
        child.timer.start()

    def _drop(self, child: RunChild) -> None:
        with self._lock:
            if self._kept is not child:
                return
            self._kept = None
        child.close()


CHILDREN = RunChildren()


def sandboxed_in_run(asked: RunWork) -> bytes:
    """As `sandboxed_with_progress`, perhaps in a child that did other jobs of the run.

    Where no fork server is, and for work or limits of many bytes, by a child of its own.
    """
    server = fork_server()
    if server is None or len(parcel(asked.work)) + len(parcel(asked.limits)) > LONGEST_BYTES:
        return sandboxed_with_progress(asked.work, asked.limits, asked.watch)
    return CHILDREN.answer(server, asked)
