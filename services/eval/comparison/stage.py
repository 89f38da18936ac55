"""The stage that compares two label sets of a sequence: packs of the store → counts in a sandbox → the record.

**Conventions.** Only a sandboxed child opens label files, and compares each with its digest. Its counts are checked
before they are accepted: every frame, and all its voxels.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from math import nan
from pathlib import Path
from secrets import token_hex
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from services.domain.sequences.label_comparisons import (
    StoredLabelFile,
    StoredPair,
    compared_by,
    stored_pairs,
    write_comparison,
)
from services.domain.sequences.stage_checks import require_sequence
from services.eval.comparison.counting import (
    Counted,
    FrameGrids,
    LabelGrids,
    LabelSetCounts,
    SeenCounts,
    counted_pairs,
    label_grids,
)
from services.eval.comparison.record import ComparedFrames, comparison_record
from services.eval.kernel_warmup import warm
from services.eval.sandboxed_truth import PackedLabelFile
from services.eval.scoring_workspace import EvalStageContext
from services.runtime.jobs.specs import Outcome
from services.runtime.orm import LabelSet
from services.runtime.sandbox import ProgressCallback, SandboxCrashedError
from services.runtime.sandbox.answers import SandboxAnswer
from services.runtime.sandbox.job_sandbox import JobSandbox
from stone.errors import Refused
from stone.scoring.metric import CLASSES
from stone.scoring.plane_layout import RINGS
from stone_base.label_grid import LabelGrid, recorded_grid

Voxels = Annotated[int, Field(ge=0, lt=2**62)]
Cells = Annotated[list[Voxels], Field(min_length=RINGS * CLASSES**2, max_length=RINGS * CLASSES**2)]
Agreement = Annotated[float, Field(ge=0, le=1)] | None


class CountsAnswer(SandboxAnswer):
    """The counts: confusions flat, [ring, A, B]; `seen_voxels` in both, in A only, in B only."""

    expected: ClassVar[str] = "the counts of two label sets"
    confusion: Cells
    seen_confusion: Cells | None
    seen_voxels: tuple[Voxels, Voxels, Voxels]
    agreements: list[Agreement]

    @classmethod
    def of(cls, counts: LabelSetCounts) -> "CountsAnswer":
        seen = counts.seen
        return cls(
            confusion=counts.confusion.ravel().tolist(),
            seen_confusion=None if seen is None else seen.confusion.ravel().tolist(),
            seen_voxels=(0, 0, 0) if seen is None else seen.voxels,
            agreements=[None if np.isnan(ratio) else float(ratio) for ratio in counts.agreements],
        )

    def counts(self, frames: int, grid: LabelGrid) -> LabelSetCounts:
        """Return the counts. Raises `SandboxCrashedError` if they do not fit this number of frames of the grid."""
        if len(self.agreements) != frames or sum(self.confusion) != frames * grid.voxels:
            raise SandboxCrashedError(f"counted other than {frames} frames")
        agreements = np.array([nan if ratio is None else ratio for ratio in self.agreements])
        if self.seen_confusion is None:
            return LabelSetCounts(_by_ring(self.confusion), None, agreements)
        seen = SeenCounts(_by_ring(self.seen_confusion), self.seen_voxels)
        return LabelSetCounts(_by_ring(self.confusion), seen, agreements)


@dataclass(frozen=True)
class PackedPairs:
    """The label files of all frames in A and in B, their packs by number, and their grid; a plain value."""

    packs: Mapping[int, Path]
    pairs: tuple[tuple[PackedLabelFile, PackedLabelFile], ...]
    grid: LabelGrid

    def grids(self, index: int) -> tuple[LabelGrids, LabelGrids]:
        """Return the labels of a frame. Raises `labels_unfit`, `short_pack`, `GroundTruthError`."""
        a, b = (label_grids(file.read(self.packs), Path(file.name), self.grid) for file in self.pairs[index])
        return a, b

    def frames(self) -> Iterator[FrameGrids]:
        return (partial(self.grids, index) for index in range(len(self.pairs)))


def compare_label_sets(context: EvalStageContext) -> Outcome:
    """Count the job's comparison.

    Raises `JobCancelledError`, `nothing_in_common`, `SandboxCrashedError`, and what the store raises.
    """
    attempt = context.attempt
    with context.platform.database.reading() as session:
        require_sequence(session, attempt)
        comparison = compared_by(session, attempt)
        if comparison.finished_ns is not None:
            return Outcome({"comparison_id": comparison.id})
        pairs = stored_pairs(session, comparison)
        a, b = (session.get_one(LabelSet, label_set_id) for label_set_id in (comparison.a_id, comparison.b_id))
        totals, grid = (a.frames, b.frames), recorded_grid(a.grid)
    if not pairs:
        raise no_shared_frame(comparison.a_id, comparison.b_id, totals)
    counts = _count_in_child(context, pairs, grid)
    frames = ComparedFrames([pair.a.token for pair in pairs], totals[0] - len(pairs), totals[1] - len(pairs))
    record = comparison_record(frames, counts)
    attempt.log("compared", frames=len(pairs))
    result = {"comparison_id": comparison.id, "frames": len(pairs)}
    return Outcome(result, commit=lambda session: write_comparison(session, attempt, record))


def count_pairs(packed: PackedPairs, _folder: Path, progress: ProgressCallback) -> bytes:
    """Count in the child. Raises as `PackedPairs.grids`."""
    return CountsAnswer.of(counted_pairs(packed.frames(), len(packed.pairs), packed.grid, progress)).packed()


def _count_in_child(context: EvalStageContext, pairs: list[StoredPair], grid: LabelGrid) -> LabelSetCounts:
    packed = _packed(context, pairs, grid)
    folder = context.folder / f"comparison-{token_hex(8)}"
    folder.mkdir()
    reads = tuple(packed.packs.values())
    sandbox = JobSandbox(folder, reads, context.attempt, context.platform.settings, warm)
    answer = sandbox.run(partial(count_pairs, packed), "compare", len(pairs))
    return CountsAnswer.believed(answer).counts(len(pairs), grid)


def _packed(context: EvalStageContext, pairs: list[StoredPair], grid: LabelGrid) -> PackedPairs:
    """Return the local packs, and the position of each file in them."""
    keys = sorted({file.object_key for pair in pairs for file in (pair.a, pair.b)})
    numbers = {key: number for number, key in enumerate(keys)}

    def packed(file: StoredLabelFile) -> PackedLabelFile:
        position = (numbers[file.object_key], file.offset_bytes, file.length_bytes)
        return PackedLabelFile(f"{file.token}/labels.npz", *position, file.sha256)

    store = context.platform.store
    packs = {number: store.local(key) for key, number in numbers.items()}
    return PackedPairs(packs, tuple((packed(pair.a), packed(pair.b)) for pair in pairs), grid)


def _by_ring(cells: list[int]) -> Counted:
    return np.array(cells, np.int64).reshape(RINGS, CLASSES, CLASSES)


def no_shared_frame(a: str, b: str, frames: tuple[int, int]) -> Refused:
    return Refused(
        "nothing_in_common",
        f"{a} ({frames[0]} frames) and {b} ({frames[1]} frames) share no frame token. Tokens are made from the "
        "sequence's name and the stamp; were the labels made from the same run, under the same name?",
    )
