"""The sandbox of a job's attempt: its folder, its readable files, its limits, progress and cancellation.

**Conventions.** The child maps recordings, so its address space may exceed memory by twice the size of its input;
temporary copies lie in the folder.
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
DESCRIPTORS = 2048  # a bag may consist of many files, each of them open
SLACK_BYTES = 2**30
# Limits for a job's output: a base for the smallest recording, and more for each input byte (labels compress well).
FOLDER_FILES, FOLDER_BYTES = 200_000, 64 * 2**30
BYTES_A_FILE, BYTES_A_BYTE = 4096, 64

SandboxedWork = Callable[[Path, ProgressCallback], bytes]


@dataclass(frozen=True)
class JobSandbox:
    """The folder of a job's work, its inputs (files, and everything below folders), and its attempt.

    `warm` compiles the needed kernels if no fork server has. `temporary`, within the folder or the folder itself, is
    for temporary files. With `shares_run` the folder and all inputs belong to the run, and its jobs may share a child.
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
            cpu_s=2 * int(limit_s),  # hashing and reading run in parallel
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
        """Return the answer of `work(folder, progress)`.

        Raises as `sandboxed_with_progress`, and `JobCancelledError`.
        """
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
    """Yield a new hidden folder below `parent`; delete it with its contents afterwards."""
    parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".apart-", dir=parent) as folder:
        yield Path(folder).resolve()


def _work(folder: Path, temporary: str, work: SandboxedWork, progress: ProgressCallback) -> bytes:
    """Run the child's part."""
    tempfile.tempdir = temporary
    return work(folder, progress)


def sandbox_watch_of(attempt: Attempt, stage: str, total: int) -> SandboxWatch:
    """Return a watch that forwards the child's progress and repeats the last, which detects cancellation."""
    last = [(stage, 0, total)]

    def forward(stage: str, done: int, total: int) -> None:
        last[0] = (stage, done, total)
        attempt.progress(*last[0])

    return SandboxWatch(on_poll=lambda: attempt.progress(*last[0]), progress=forward)


# A sandboxed child that is kept for the next job of the same run, which reuses its process and memory.
#
# **Conventions.** A process keeps at most one child, for one run of one sequence of one owner. A job of another run
# ends it, so no child ever serves two runs. So does a job that shares no child or needs wider fences, since fences are
# never widened. The child may write in the run's own folder and read the run's own recording. If a recording takes over
# the child, it can access only files that the run's jobs may access anyway, and can spoil only that recording's labels.
#
# The child ends if it was idle for `IDLE_S`, breaks, is stopped, sends an unrequested message, or uses much; it
# also ends with its process. Each job has its own wall time. Its processor time is its full limit, with at most
# `MOST_USED_S` already used; its memory is counted beyond the memory kept. If a reused child breaks, earlier jobs may
# be the cause: a fresh child runs the job before the input is blamed. A kill from outside costs the attempt, as for any
# child (`services/runtime/sandbox/parent.py`).


IDLE_S = 5.0
MOST_HELD_BYTES = 2**30
MOST_USED_S = 300
BY_READ = ("mapped_bytes", "file_bytes", "folder_files", "folder_bytes")  # limits that grow with the bytes read
LONGEST_BYTES = 2**15  # longest work: a pipe accepts this much without a reader

log = structlog.get_logger(__name__)


@dataclass(eq=False)
class RunChild:
    """A child of a run, its limits, and the pipe for its works."""

    run_id: str
    limits: SandboxLimits
    process: SandboxProcess
    served: ServedChild
    works: int
    inodes: tuple[tuple[int, int], ...]
    timer: Timer | None = None

    def answer(self, work: Work, watch: SandboxWatch) -> bytes:
        """Send a work and return its answer. Raises as `sandboxed`."""
        try:
            os.write(self.works, parcel(work))
        except BrokenPipeError:
            raise SandboxInterruptedError("ended between two jobs") from None
        return self.process.answer(watch)

    def is_worth_keeping(self) -> bool:
        """Return whether another job may use the child."""
        used = self.served.note_usage()
        return self.process.is_waiting and used.cpu_s < MOST_USED_S and used.held_bytes < MOST_HELD_BYTES

    def serves(self, run_id: str, limits: SandboxLimits) -> bool:
        """Return whether the child is idle and its limits cover those of a job."""
        given = {name: getattr(self.limits, name) for name in BY_READ}
        is_enough = all(getattr(limits, name) <= most for name, most in given.items())
        is_enough = is_enough and set(limits.reads) <= set(self.limits.reads)
        is_alike = replace(limits, reads=self.limits.reads, **given) == self.limits
        is_theirs = self.run_id == run_id and is_enough and is_alike
        return is_theirs and self.inodes == _identify_files(self.limits) and self.process.is_waiting

    def close(self) -> None:
        """End the child and remove everything of it."""
        os.close(self.works)
        self.process.close()


def begun_child(server: ForkServer, run_id: str, limits: SandboxLimits) -> RunChild:
    """Start a fresh child of the run."""
    inodes = _identify_files(limits)
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


def _identify_files(limits: SandboxLimits) -> tuple[tuple[int, int], ...]:
    """Return the files that its fences allow, as inodes: names may refer to other files later."""
    files = (os.stat(path) for path in (*limits.reads, *([limits.folder] if limits.folder else [])) if path.exists())
    return tuple((facts.st_dev, facts.st_ino) for facts in files)


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

    def answer(self, server: ForkServer, wanted: RunWork) -> bytes:
        """Run the work in the kept child or a fresh one. Raises as `sandboxed`."""
        kept = self._take(wanted)
        if kept is not None:
            try:
                return self._answer(kept, wanted)
            except SandboxCrashedError as error:
                log.warning("a reused child broke: the job runs again in a fresh child", fate=error.fate)
        return self._answer(begun_child(server, wanted.run_id, wanted.limits), wanted)

    def close(self) -> None:
        """End the kept child, if there is one."""
        with self._lock:
            kept, self._kept = self._kept, None
        if kept is not None:
            kept.close()

    def _answer(self, child: RunChild, wanted: RunWork) -> bytes:
        try:
            return child.answer(wanted.work, wanted.watch)
        finally:
            if child.is_worth_keeping():
                self._keep(child)
            else:
                child.close()

    def _take(self, wanted: RunWork) -> RunChild | None:
        """Return the kept child if it serves; otherwise end it."""
        with self._lock:
            kept, self._kept = self._kept, None
        if kept is None:
            return None
        if kept.timer is not None:
            kept.timer.cancel()
        if kept.serves(wanted.run_id, wanted.limits):
            return kept
        kept.close()
        return None

    def _keep(self, child: RunChild) -> None:
        """Keep the child until the next job, for a limited time."""
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


def sandboxed_in_run(wanted: RunWork) -> bytes:
    """Do as `sandboxed_with_progress`, if possible in a child that did other jobs of the run.

    Without a fork server, and for work or limits of many bytes, use a separate child.
    """
    server = fork_server()
    if server is None or len(parcel(wanted.work)) + len(parcel(wanted.limits)) > LONGEST_BYTES:
        return sandboxed_with_progress(wanted.work, wanted.limits, wanted.watch)
    return CHILDREN.answer(server, wanted)
