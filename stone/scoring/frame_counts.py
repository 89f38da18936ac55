"""The counts of a frame, independent of their implementation, and the frames in which columns are counted.

**Conventions.** A confusion matrix is [ring, truth, prediction] int32; columns seen from above are counted as [ring,
3]: drivable in both, only in the truth, only in the prediction (`stone/scoring/bitplanes.py`,
`stone/scoring/columns.py`). This module needs only NumPy.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone.errors import StoneError
from stone.scoring.metric import CLASSES
from stone.scoring.plane_layout import RINGS
from stone_base.label_grid import PAPER, LabelGrid

Confusion = NDArray[np.int32]
Drivable = NDArray[np.int32]
Planes = NDArray[np.uint64]

CLEARANCE_M = 1.6
"""Minimum height of an obstacle that a robot drives under."""

COUNTED_FRAMES = 250


class LabelRangeError(StoneError):
    """A grid contains a value that is not a class."""

    code = "label_out_of_range"

    def __init__(self, value: int) -> None:
        self.value = value
        super().__init__(
            f"a voxel has class {value}; classes are 0 to 3 (does your prediction use 255 for unknown, or "
            "another class map?)"
        )


@dataclass(frozen=True, eq=False)
class TruthPlanes:
    """Ground truth of one frame, sorted by ring: `planes` (3, words) = low, high, evaluated.

    `counts` (3, 4) are, by ring, the evaluated voxels, and those with the low, the high and both bits set. `late`
    (words,) are the voxels of `stone.labels.late_voxels`, evaluated or not; None if unknown.
    """

    planes: Planes
    counts: NDArray[np.int64]
    grid: LabelGrid = PAPER
    late: Planes | None = None


@dataclass(frozen=True, eq=False)
class ColumnCounts:
    """The counts of `stone.scoring.columns`: `pairs` (…, 3, 4) [ring, set], `columns` (…, 3, 4, 4) as confusion
    matrices.
    """

    pairs: NDArray[np.int32]
    columns: Confusion

    def of_frame(self, index: int) -> "ColumnCounts":
        """Return the counts of one frame, as a view."""
        return ColumnCounts(self.pairs[index], self.columns[index])


@dataclass(frozen=True, eq=False)
class FrameCounts:
    """The counts of a frame: `confusion` (3, 4, 4) [ring, truth, prediction] in voxels, `bev` (3, 3) in columns."""

    confusion: Confusion
    bev: Drivable
    column_counts: ColumnCounts


def no_column_counts(shape: tuple[int, ...]) -> ColumnCounts:
    """Return column counts of frames of this shape, all zero."""
    return ColumnCounts(
        np.zeros((*shape, RINGS, CLASSES), np.int32), np.zeros((*shape, RINGS, CLASSES, CLASSES), np.int32)
    )


def overhead_voxels(voxel_m: float) -> int:
    """Return the number of voxels between a surface and an N that leaves `CLEARANCE_M` between them."""
    return round(CLEARANCE_M / voxel_m) + 1


def counted_every(frames: int) -> int:
    """Return n: the first and every n-th frame are counted."""
    return max(1, -(-frames // COUNTED_FRAMES))
