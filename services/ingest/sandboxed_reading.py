"""Sandboxed reading of uploaded recordings: a child process with a folder that is deleted afterwards.

**Conventions.** The child maps the recording, so address space beyond memory is allowed for twice its size; temporary
copies (`bags/private_folder.py`) lie in the folder. What numba compiles in the child for a layout of points
that was not warmed up is used and not kept: whatever a child could add to numba's cache would run in every worker.
"""

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from numba.core.caching import FunctionCache

from services.ingest.kernel_warmup import warm
from services.runtime.jobs.specs import Attempt
from services.runtime.sandbox import ProgressCallback, SandboxLimits, sandboxed_with_progress
from services.runtime.sandbox.job_watch import sandbox_watch_of
from services.runtime.settings import Settings

MEMORY_BYTES = 4 * 2**30
ANSWER_BYTES = 128 * 2**20
DESCRIPTORS = 2048  # a bag may be split into many files, each of them open
SLACK_BYTES = 2**30

Reading = Callable[[Path, ProgressCallback], bytes]


@dataclass(frozen=True)
class SandboxedReading:
    """The folder of one reading, what is read, and for whom."""

    folder: Path
    files: tuple[Path, ...]
    attempt: Attempt
    settings: Settings

    @property
    def limits(self) -> SandboxLimits:
        limit_s = self.settings.jobs.time_limit_s
        return SandboxLimits(
            memory_bytes=MEMORY_BYTES,
            cpu_s=2 * int(limit_s),  # hashing and reading go side by side
            wall_s=limit_s,
            answer_bytes=ANSWER_BYTES,
            descriptors=DESCRIPTORS,
            mapped_bytes=SLACK_BYTES + 2 * sum(file.stat().st_size for file in self.files),
            folder=self.folder,
            file_bytes=self.settings.uploads.max_bytes,
        )

    def read(self, work: Reading, stage: str, total: int) -> bytes:
        """The answer of `work(folder, progress)`. Raises as `sandboxed_with_progress`."""
        warm()
        return sandboxed_with_progress(
            partial(_work, self.folder, work), self.limits, sandbox_watch_of(self.attempt, stage, total)
        )


@contextmanager
def private_folder_in(parent: Path) -> Iterator[Path]:
    """A fresh hidden folder below `parent`; it goes with whatever is left in it."""
    parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".apart-", dir=parent) as folder:
        yield Path(folder).resolve()


def _work(folder: Path, work: Reading, progress: ProgressCallback) -> bytes:
    """The child's part."""
    tempfile.tempdir = str(folder)
    FunctionCache.save_overload = _keep_nothing  # type: ignore[method-assign,assignment]
    return work(folder, progress)


def _keep_nothing(_cache: FunctionCache, _signature: object, _compiled: object) -> None:
    """In the place of what would write to numba's cache."""
