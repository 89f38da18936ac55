"""The sandbox of a job's attempt: its folder, what it may read, its limits, progress and cancellation.

**Conventions.** The child maps recordings, so address space beyond memory is allowed for twice the size of what it
reads; temporary copies lie in the folder.
"""

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from services.runtime.jobs.specs import Attempt
from services.runtime.sandbox.child import ProgressCallback
from services.runtime.sandbox.fork_client import warm_unless_served
from services.runtime.sandbox.kept_child import CHILDREN, RunWork, sandboxed_in_run
from services.runtime.sandbox.limits import SandboxLimits
from services.runtime.sandbox.parent import SandboxWatch, sandboxed_with_progress
from services.runtime.settings import Settings

MEMORY_BYTES = 4 * 2**30
ANSWER_BYTES = 128 * 2**20
DESCRIPTORS = 2048  # a bag may be split into many files, each of them open
SLACK_BYTES = 2**30

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
        return SandboxLimits(
            memory_bytes=MEMORY_BYTES,
            cpu_s=2 * int(limit_s),  # hashing and reading go side by side
            wall_s=limit_s,
            answer_bytes=ANSWER_BYTES,
            descriptors=DESCRIPTORS,
            mapped_bytes=SLACK_BYTES + 2 * sum(path.stat().st_size for path in self.reads),
            folder=self.folder,
            file_bytes=self.settings.uploads.max_bytes,
            reads=self.reads,
            makes_links=self.makes_links,
        )

    def run(self, work: SandboxedWork, stage: str, total: int) -> bytes:
        """The answer of `work(folder, progress)`. Raises as `sandboxed_with_progress`, and `JobCancelledError`."""
        warm_unless_served(self.warm)
        temporary = self.temporary or self.folder
        task = partial(_work, self.folder, str(temporary), work)
        watch = sandbox_watch_of(self.attempt, stage, total)
        if self.shares_run:
            return sandboxed_in_run(RunWork(self.attempt.root_id, task, self.limits, watch))
        CHILDREN.close()  # one child at a time
        return sandboxed_with_progress(task, self.limits, watch)


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
