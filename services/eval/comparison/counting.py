"""Counts of two label sets, frame by frame: over all voxels, and over voxels that were observed in both.

**Conventions.** Confusions are [ring, A, B] (`stone/scoring/agreement.py`). A voxel is *seen* if `mask_lidar` is not 0.
One frame of both sets is in memory at a time.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stone.labels.grid import Grid
from stone.scoring.agreement import agreement_ratios
from stone.scoring.bitplanes import count_by_ring, truth_planes
from stone.scoring.frame_counts import LabelRangeError
from stone.scoring.metric import CLASSES
from stone.scoring.plane_layout import RINGS
from stone_base.label_grid import LabelGrid
from stone_submissions.errors import GroundTruthError, SubmissionError
from stone_submissions.ground_truth import KEYS
from stone_submissions.npz_frame import npz_members, read_grid
from stone_submissions.validation import Progress, silent

SEMANTICS, SEEN = "semantics", "mask_lidar"
Counted = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class LabelGrids:
    """The labels of a frame, uint8 of the grid's shape; `seen` is None if the file has no mask."""

    semantics: Grid
    seen: Grid | None


FrameGrids = Callable[[], tuple[LabelGrids, LabelGrids]]


@dataclass(frozen=True, eq=False)
class SeenCounts:
    """Counts over commonly seen voxels: `confusion` (3, 4, 4), and voxels `seen` in both, in A only and in B only."""

    confusion: Counted
    voxels: tuple[int, int, int]


@dataclass(frozen=True, eq=False)
class LabelSetCounts:
    """Sums over F frames: `confusion` (3, 4, 4) of all voxels; `agreements` (F,), NaN if nothing is occupied.

    `seen` is None if a frame of either set has no mask.
    """

    confusion: Counted
    seen: SeenCounts | None
    agreements: NDArray[np.float64]


def label_grids(npz: bytes, path: Path, grid: LabelGrid) -> LabelGrids:
    """Return the labels in a label file at a grid, read as strictly as a submission. Raises `GroundTruthError`."""
    try:
        members = npz_members(npz)
        if SEMANTICS not in members or not members.keys() <= KEYS:
            raise GroundTruthError(path, f"its arrays are {', '.join(sorted(members))[:200]}, not semantics and masks")
        seen = read_grid(npz, members[SEEN], grid) if SEEN in members else None
        semantics = read_grid(npz, members[SEMANTICS], grid)
        if (highest := int(semantics.max())) >= CLASSES:
            raise LabelRangeError(highest)
        return LabelGrids(semantics, seen)
    except (SubmissionError, LabelRangeError) as error:
        raise GroundTruthError(path, str(error)) from error


def counted_pairs(
    frames: Iterable[FrameGrids], total: int, grid: LabelGrid, progress: Progress = silent
) -> LabelSetCounts:
    """Return the counts of `total` frames of a grid, one after another. Raises what a frame raises."""
    everywhere, where_seen = (np.zeros((RINGS, CLASSES, CLASSES), np.int64) for _ in range(2))
    voxels, agreements, says_seen = np.zeros(3, np.int64), np.full(total, np.nan), True
    for index, grids in enumerate(frames):
        a, b = grids()
        of_frame = _confusion(a, b, np.ones(grid.shape, np.bool_), grid)
        everywhere += of_frame
        agreements[index] = agreement_ratios(of_frame.sum(axis=0))
        if a.seen is None or b.seen is None:
            says_seen = False
        elif says_seen:
            where_seen += _confusion(a, b, (a.seen != 0) & (b.seen != 0), grid)
            voxels += _seen_voxels(a.seen, b.seen)
        progress("compare", index + 1, total)
    both, in_a, in_b = voxels.tolist()
    seen = SeenCounts(where_seen, (both, in_a - both, in_b - both)) if says_seen else None
    return LabelSetCounts(everywhere, seen, agreements)


def _confusion(a: LabelGrids, b: LabelGrids, is_evaluated: NDArray[np.bool_], grid: LabelGrid) -> Counted:
    confusion, bev = np.empty((RINGS, CLASSES, CLASSES), np.int32), np.empty((RINGS, 3), np.int32)
    count_by_ring(b.semantics, truth_planes(a.semantics, is_evaluated, grid), confusion, bev)
    return confusion.astype(np.int64)


def _seen_voxels(a: Grid, b: Grid) -> Counted:
    """Return the numbers of voxels seen in both, in A and in B."""
    return np.array([np.count_nonzero((a != 0) & (b != 0)), np.count_nonzero(a), np.count_nonzero(b)], np.int64)
