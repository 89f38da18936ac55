"""The excerpt of a recording in a bucket: the messages needed for labels, stored as MCAP files.

    ranges → a sparse file → a sandboxed child lists missing ranges, or writes messages → holes again

**Conventions.** The parent fetches bytes without parsing them; the child, which has no network, reads the file and
returns ranges. Bytes are local for a few chunks at a time, so that little more than the excerpt is stored.
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from services.ingest.kernel_warmup import warm
from services.runtime.in_place.bucket import PlacedObject, Range, punch, sparse_file
from services.runtime.jobs.specs import Attempt
from services.runtime.platform import Platform
from services.runtime.sandbox import ProgressCallback, SandboxCrashedError
from services.runtime.sandbox.job_sandbox import JobSandbox, private_folder_in
from stone_recordings.bags.mcap.excerpt import first_ranges, planned_excerpt, write_excerpt
from stone_recordings.sync.stored_recording import RecordingPlace

BATCH_BYTES = 64 * 2**20
MOST_PARTS = 400
ROUNDS = 3  # its ends, its summary, its message indexes


@dataclass(frozen=True)
class _Chunks:
    """Chunks by number, half-open, and the ranges of their messages."""

    numbers: Range
    ranges: tuple[Range, ...]


@dataclass(frozen=True, eq=False)
class ExcerptMaker:
    """Makes the files in `folder`. `fetched_bytes` counts the bytes read from the object."""

    platform: Platform
    attempt: Attempt
    source: RecordingPlace
    folder: Path

    def made(self) -> tuple[tuple[Path, ...], int]:
        """Return the files, in the order of the recording, and the number of bytes read for them.

        Raises what reading the object and the bag raise, `SandboxCrashedError`, `JobCancelledError`.
        """
        source = PlacedObject(self.platform.settings.in_place, self.source)
        with private_folder_in(self.folder) as work:
            whole, parts = work / self.source.name, list[Path]()
            sparse_file(whole, self.source.size_bytes)
            batches = _batches(self._plan_chunks(source, whole))
            for number, batch in enumerate(batches):
                self.attempt.progress("fetch", number, len(batches))
                source.fetch(batch.ranges, whole)
                part = work / f"{whole.stem}_{number}.part"
                self._ask(work, partial(_write, whole.name, batch.numbers, part.name, self.source.with_pictures))
                _refuse_link(part)
                parts.append(part.replace(self.folder / f"{whole.stem}_{number}{whole.suffix}"))
                punch(whole, batch.ranges)
        return tuple(parts), source.read_bytes

    def _plan_chunks(self, source: PlacedObject, whole: Path) -> list[_Chunks]:
        here = lacks = first_ranges(self.source.size_bytes)
        for _round in range(ROUNDS):
            source.fetch(lacks, whole)
            task = partial(_plan, whole.name, tuple(here), self.source.with_pictures)
            plan = json.loads(self._ask(whole.parent, task))
            lacks, chunks = self._validate_plan(plan)
            if not lacks:
                return chunks
            here = [*here, *lacks]
        raise SandboxCrashedError("requested more of a file than its index")

    def _ask(self, work: Path, task: Any) -> bytes:
        sandbox = JobSandbox(work, (work / self.source.name,), self.attempt, self.platform.settings, warm)
        return sandbox.run(task, "fetch", 1)

    def _validate_plan(self, plan: Any) -> tuple[list[Range], list[_Chunks]]:
        """Return the ranges in the plan. Raises `SandboxCrashedError` for anything but ranges of the object."""
        match plan:
            case {"lacks": list(lacks), "chunks": list(chunks)}:
                parts = [_Chunks((int(number), int(number) + 1), self._ranges(ranges)) for number, ranges in chunks]
                return list(self._ranges(lacks)), parts
        raise SandboxCrashedError("returned something other than ranges")

    def _ranges(self, pairs: Any) -> tuple[Range, ...]:
        ranges = tuple((int(start), int(stop)) for start, stop in pairs)
        if any(not 0 <= start < stop <= self.source.size_bytes for start, stop in ranges):
            raise SandboxCrashedError("requested bytes beyond the object's end")
        return ranges


def _batches(chunks: Sequence[_Chunks]) -> list[_Chunks]:
    """Return groups of consecutive chunks, of `BATCH_BYTES` each, or larger to limit them to `MOST_PARTS`."""
    total_bytes = sum(stop - start for chunk in chunks for start, stop in chunk.ranges)
    return list(_group_chunks(chunks, max(BATCH_BYTES, total_bytes // MOST_PARTS)))


def _group_chunks(chunks: Sequence[_Chunks], most_bytes: int) -> Iterator[_Chunks]:
    group, size_bytes = list[_Chunks](), 0
    for chunk in chunks:
        group.append(chunk)
        size_bytes += sum(stop - start for start, stop in chunk.ranges)
        if size_bytes >= most_bytes:
            yield _as_one(group)
            group, size_bytes = [], 0
    if group:
        yield _as_one(group)


def _as_one(group: Sequence[_Chunks]) -> _Chunks:
    numbers = (group[0].numbers[0], group[-1].numbers[1])
    return _Chunks(numbers, tuple(range_ for chunks in group for range_ in chunks.ranges))


def _plan(name: str, here: Sequence[Range], with_pictures: bool, folder: Path, _progress: ProgressCallback) -> bytes:
    """Plan the excerpt in the child."""
    plan = planned_excerpt(folder / name, here, with_pictures=with_pictures)
    return json.dumps({"lacks": plan.lacks, "chunks": plan.chunks}).encode()


def _write(
    name: str, chunks: Range, target: str, with_pictures: bool, folder: Path, _progress: ProgressCallback
) -> bytes:
    """Write the excerpt in the child."""
    return str(write_excerpt(folder / name, chunks, folder / target, with_pictures=with_pictures)).encode()


def _refuse_link(path: Path) -> None:
    if path.is_symlink() or not path.is_file():
        raise SandboxCrashedError("wrote no excerpt at the given path")
