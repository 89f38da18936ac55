"""Counts of a frame with NumPy only: as `stone.scoring.bitplanes`, for machines without its compiled kernels.

**Conventions.** Functions have the names, planes and counts of `stone.scoring.bitplanes` and `stone.scoring.columns`,
but are slower. A word is a column, bit 0 its lowest voxel.
"""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from stone.errors import ShapeError
from stone.scoring.frame_counts import (
    ColumnCounts,
    Confusion,
    Drivable,
    LabelRangeError,
    TruthPlanes,
    overhead_voxels,
)
from stone.scoring.metric import CLASSES
from stone.scoring.plane_layout import RINGS, layout_of
from stone_base.label_grid import PAPER, LabelGrid

Grid = NDArray[np.uint8]
Columns = NDArray[np.uint32]
_BYTE_BITS = np.array([bin(byte).count("1") for byte in range(256)], np.uint8)


def truth_planes(
    grid: Grid, is_evaluated: NDArray[np.bool_], label_grid: LabelGrid = PAPER, is_late: NDArray[np.bool_] | None = None
) -> TruthPlanes:
    """Prepare ground truth as `bitplanes.truth_planes` does. Raises `ShapeError`, `LabelRangeError`."""
    low, high = _sorted_planes(grid, label_grid)
    valid, _ = _sorted_planes(is_evaluated.astype(np.uint8), label_grid)
    late = None if is_late is None else _sorted_planes(is_late.astype(np.uint8), label_grid)[0].view(np.uint64)
    planes = np.stack([low & valid, high & valid, valid])
    sets = (valid, *planes[:2], planes[0] & planes[1])
    counts = [[_bits(words[ring]) for words in sets] for ring in _rings(label_grid)]
    return TruthPlanes(planes.view(np.uint64), np.array(counts, np.int64), label_grid, late)


def count_by_ring(
    prediction: Grid,
    truth: TruthPlanes,
    confusion_out: Confusion,
    bev_out: Drivable,
    columns_out: ColumnCounts | None = None,
) -> None:
    """Write the counts of one frame, as `bitplanes.count_by_ring` does. Raises `ShapeError`, `LabelRangeError`."""
    low, high = _sorted_planes(prediction, truth.grid)
    truth_low, truth_high, valid = truth.planes.view(np.uint32)
    overhead = overhead_voxels(truth.grid.voxel_m)
    for ring, places in enumerate(_rings(truth.grid)):
        evaluated = valid[places]
        true = _classes(truth_low[places], truth_high[places], evaluated)
        predicted = _classes(low[places] & evaluated, high[places] & evaluated, evaluated)
        confusion_out[ring] = [[_bits(a & b) for b in predicted] for a in true]
        is_true, is_predicted = (((t | p) != 0) & (n == 0) for _, t, p, n in (true, predicted))
        both = is_true & is_predicted
        bev_out[ring] = [both.sum(), (is_true & ~both).sum(), (is_predicted & ~both).sum()]
        if columns_out is not None:
            columns_out.pairs[ring] += _pairs(true, predicted)
            columns = _columns_of(truth.grid, ring)
            true_classes, classes = (_column_classes(planes, overhead)[:columns] for planes in (true, predicted))
            columns_out.columns[ring] += _column_confusion(true_classes, classes)


def late_confusion(prediction: Grid, truth: TruthPlanes) -> Confusion:
    """Return the confusion (4, 4) of the evaluated late voxels, or 0 if late voxels are unknown."""
    confusion, bev = np.zeros((RINGS, CLASSES, CLASSES), np.int32), np.zeros((RINGS, 3), np.int32)
    if truth.late is not None:
        late = TruthPlanes(truth.planes & truth.late, truth.counts, truth.grid)
        count_by_ring(prediction, late, confusion, bev)
    return np.asarray(confusion.sum(axis=0, dtype=np.int32))


def _sorted_planes(grid: Grid, label_grid: LabelGrid) -> tuple[Columns, Columns]:
    """Return the low and the high bit of every voxel, one word per column. Raises `ShapeError`, `LabelRangeError`."""
    if grid.shape != label_grid.shape or grid.dtype != np.uint8:
        raise ShapeError("a label grid", grid.shape, f"{label_grid.shape} of uint8 (not {grid.dtype})")
    if grid.size and grid.max() >= CLASSES:
        raise LabelRangeError(int(grid.max()))
    layout = layout_of(label_grid)
    sources, targets = (
        np.concatenate([np.arange(run[of], run[of] + run[2]) for run in layout.runs.tolist()]) for of in (0, 1)
    )
    planes = np.zeros((2, layout.columns), np.uint32)
    for plane, bit in zip(planes, (1, 2), strict=True):
        packed = np.packbits(grid & bit, axis=-1, bitorder="little").reshape(-1, label_grid.shape[2] // 8)
        words = packed.view(f"<u{packed.shape[1]}").ravel()
        plane[targets] = words[sources]
    return planes[0], planes[1]


def _rings(grid: LabelGrid) -> list[slice]:
    """Return the positions of each ring."""
    return [slice(*ends) for ends in pairwise(layout_of(grid).bounds.tolist())]


def _columns_of(grid: LabelGrid, ring: int) -> int:
    """Return the number of columns of a ring, without unused positions."""
    chunks = layout_of(grid).chunks
    of_ring = chunks[chunks[:, 0] == ring]
    return int((of_ring[:, 3] - of_ring[:, 1]).sum())


def _classes(low: Columns, high: Columns, evaluated: Columns) -> tuple[Columns, Columns, Columns, Columns]:
    """Return the evaluated voxels of each class."""
    return evaluated & ~(low | high), low & ~high, high & ~low, low & high


def _bits(words: Columns) -> int:
    return int(_BYTE_BITS[np.ascontiguousarray(words).view(np.uint8)].sum(dtype=np.int64))


def _bits_of_columns(words: Columns) -> NDArray[np.uint8]:
    """Return the bits of each word."""
    return np.asarray(_BYTE_BITS[words.view(np.uint8).reshape(-1, 4)].sum(axis=1, dtype=np.uint8))


def _thickened(column: Columns) -> Columns:
    """Return the columns with the voxels above and below."""
    return np.asarray(column | (column << 1) | (column >> 1), np.uint32)


def _pairs(true: tuple[Columns, ...], predicted: tuple[Columns, ...]) -> list[int]:
    """Return the pairs of occupied, T, P and N."""
    sets = [(true[1] | true[2] | true[3], predicted[1] | predicted[2] | predicted[3])]
    return [
        int(np.minimum(_bits_of_columns(a & _thickened(b)), _bits_of_columns(b & _thickened(a))).sum(dtype=np.int64))
        for a, b in (*sets, *zip(true[1:], predicted[1:], strict=True))
    ]


def _column_classes(planes: tuple[Columns, ...], overhead: int) -> NDArray[np.uint8]:
    """Return the worst class of each column, without N voxels above the robot."""
    _, t, p, n = planes
    surface = (t | p).astype(np.uint64)
    lowest = surface & (~surface + np.uint64(1))
    within_reach = (lowest << np.uint64(overhead)) - np.uint64(1)  # all voxels if there is no surface
    is_n = (n.astype(np.uint64) & within_reach) != 0
    return np.where(is_n, 3, np.where(p != 0, 2, np.where(t != 0, 1, 0))).astype(np.uint8)


def _column_confusion(true: NDArray[np.uint8], predicted: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Return the confusion matrix of these columns."""
    pairs = true * np.uint8(CLASSES) + predicted
    return np.bincount(pairs, minlength=CLASSES * CLASSES).reshape(CLASSES, CLASSES)
