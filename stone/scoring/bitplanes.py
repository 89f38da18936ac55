"""Confusion matrices of label grids by bit planes and population counts: exact integers, one to two memory passes.

**Conventions.** A grid is (X, Y, Z) uint8, z fastest, classes 0–3; Z divides 32. Class bits are split into a low and a
high plane with one bit per voxel; a column (up to 32 voxels along z) is one uint32. Columns are ordered as in
`stone.scoring.plane_layout`. Truth planes are ANDed with the plane of evaluated voxels in advance. Confusion matrices
are [ring, truth, prediction]. Seen from above, a column is drivable if its evaluated voxels contain a T or P and no N.
Columns drivable in both, only in the truth and only in the prediction are counted as [ring, 3]. The counts of
`stone.scoring.columns` use the same planes if they are requested.

Source: counts of unions from counts of intersections by inclusion–exclusion; the planes are a bitmap index (O'Neil and
Quass, 1997).
"""

from dataclasses import replace
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.errors import ShapeError
from stone.kernels.column_words import drivable32, pack1, pack8
from stone.kernels.lanes import popcount, prefetch
from stone.labels.grid import Grid
from stone.scoring.columns import count_columns, count_pairs
from stone.scoring.frame_counts import (
    ColumnCounts,
    Confusion,
    Drivable,
    FrameCounts,
    LabelRangeError,
    Planes,
    TruthPlanes,
    no_column_counts,
    overhead_voxels,
)
from stone.scoring.metric import CLASSES
from stone.scoring.plane_layout import CHUNK, RINGS, layout_of
from stone_base.label_grid import PAPER, LabelGrid

WORD = 32  # voxels

Columns = NDArray[np.uint32]


@njit(cache=True, nogil=True)
def _pack(source: Any, runs: NDArray[np.int64], low: Columns, high: Columns, wanted: Columns) -> np.uint64:
    """Write both planes of the columns in `runs`, sorted, from 0; return not 0 if a voxel is above 3.

    Packing leaves memory bandwidth unused, so the same columns of `wanted` (planes, columns) are prefetched meanwhile.
    """
    voxels, height = source
    origin = runs[0, 1]
    beyond = np.uint64(0)
    for _ in range(np.int64(height < WORD)):
        beyond |= _pack_low(voxels, height, runs, low, high)
    for r in range(runs.shape[0] * np.int64(height == WORD)):
        start, target, columns = runs[r, 0], runs[r, 1] - origin, runs[r, 2]
        many = columns - columns % 8
        for i in range(0, many, 8):
            beyond |= pack8(voxels, 32 * (start + i), low, high, target + i)
            for plane in range(wanted.shape[0]):
                prefetch(wanted, plane * wanted.shape[1] + target + origin + i)
        for i in range(many, columns):
            beyond |= pack1(voxels, 32 * (start + i), low, high, target + i)
    return beyond


@njit(cache=True, nogil=True)
def _pack_low(voxels: Grid, height: int, runs: NDArray[np.int64], low: Columns, high: Columns) -> np.uint64:
    """Do the same as `_pack` for columns of 8 or 16 voxels: 256 bytes are packed into words of several narrow columns.

    At the end of a run, the next columns are also packed and discarded; there may be none at the end of the grid.
    """
    origin, beyond, at_once = runs[0, 1], np.uint64(0), 256 // height
    near_low, near_high = np.empty(8, np.uint32), np.empty(8, np.uint32)
    last, last_start = np.zeros(256, np.uint8), voxels.size - 256
    for r in range(runs.shape[0]):
        start, target, columns = runs[r, 0], runs[r, 1] - origin, runs[r, 2]
        for i in range(0, columns, at_once):
            begin, kept = height * (start + i), min(at_once, columns - i)
            if begin <= last_start:
                beyond |= pack8(voxels, begin, near_low, near_high, 0)
            else:
                last[: voxels.size - begin] = voxels[begin:]
                beyond |= pack8(last, 0, near_low, near_high, 0)
            if height == 16 and kept == 16:  # a constant count is vectorised
                _widen(near_low.view(np.uint16), low, target + i, 16)
                _widen(near_high.view(np.uint16), high, target + i, 16)
            elif height == 16:
                _widen(near_low.view(np.uint16), low, target + i, kept)
                _widen(near_high.view(np.uint16), high, target + i, kept)
            else:
                _widen(near_low.view(np.uint8), low, target + i, kept)
                _widen(near_high.view(np.uint8), high, target + i, kept)
    return beyond


@njit(inline="always")
def _widen(narrow: Any, out: Columns, at: int, kept: int) -> None:
    for n in range(kept):
        out[at + n] = np.uint32(narrow[n])


@njit(cache=True, nogil=True)
def _count_truth(planes: Planes, bounds: NDArray[np.int64], counts: NDArray[np.int64]) -> None:
    for ring in range(bounds.size - 1):
        for i in range(bounds[ring] // 2, bounds[ring + 1] // 2):
            low, high = planes[0, i], planes[1, i]
            counts[ring, 0] += popcount(planes[2, i])
            counts[ring, 1] += popcount(low)
            counts[ring, 2] += popcount(high)
            counts[ring, 3] += popcount(low & high)


@njit(cache=True, nogil=True)
def _joint(
    truth_low: Planes, truth_high: Planes, evaluated: Planes, low: Planes, high: Planes, joint: NDArray[np.int64]
) -> None:
    """Add the counts [truth, prediction] of (any, low, high, both); for the truth, "any" is not needed."""
    s1 = s2 = s3 = s11 = s12 = s13 = s21 = s22 = s23 = s31 = s32 = s33 = np.uint64(0)
    for i in range(low.size):
        valid = evaluated[i]
        p1, p2, g1, g2 = low[i] & valid, high[i] & valid, truth_low[i], truth_high[i]
        p3, g3 = p1 & p2, g1 & g2
        s1 += popcount(p1)
        s2 += popcount(p2)
        s3 += popcount(p3)
        s11 += popcount(g1 & p1)
        s12 += popcount(g1 & p2)
        s13 += popcount(g1 & p3)
        s21 += popcount(g2 & p1)
        s22 += popcount(g2 & p2)
        s23 += popcount(g2 & p3)
        s31 += popcount(g3 & p1)
        s32 += popcount(g3 & p2)
        s33 += popcount(g3 & p3)
    joint[0, 1] += s1
    joint[0, 2] += s2
    joint[0, 3] += s3
    joint[1, 1] += s11
    joint[1, 2] += s12
    joint[1, 3] += s13
    joint[2, 1] += s21
    joint[2, 2] += s22
    joint[2, 3] += s23
    joint[3, 1] += s31
    joint[3, 2] += s32
    joint[3, 3] += s33


@njit(cache=True, nogil=True)
def _drivable(truth: Any, evaluated: Any, low: Any, high: Any, bev: NDArray[np.int64]) -> None:
    """Add the columns drivable in (both, truth, prediction); one uint32 per column, an even number of columns."""
    truth_low, truth_high = truth
    both = in_truth = in_prediction = np.uint64(0)
    whole = low.size - low.size % 32
    for i in range(0, whole, 32):
        predicted = drivable32(low, high, evaluated, i)
        true = drivable32(truth_low, truth_high, evaluated, i)
        both += popcount(np.uint64(predicted & true))
        in_truth += popcount(np.uint64(true))
        in_prediction += popcount(np.uint64(predicted))
    for i in range(whole, low.size):
        p1, p2, g1, g2 = low[i] & evaluated[i], high[i] & evaluated[i], truth_low[i], truth_high[i]
        p, g = ((p1 & p2) == 0) & ((p1 | p2) != 0), ((g1 & g2) == 0) & ((g1 | g2) != 0)
        both += np.uint64(p & g)
        in_truth += np.uint64(g)
        in_prediction += np.uint64(p)
    bev[0] += np.int64(both)
    bev[1] += np.int64(in_truth)
    bev[2] += np.int64(in_prediction)


@njit(cache=True, nogil=True)
def _exact(joint: NDArray[np.int64]) -> None:
    """Convert counts of (any, low, high, both) in place to counts of classes 0–3 on both axes, by
    inclusion–exclusion.
    """
    for k in range(4):
        joint[0, k] += joint[3, k] - joint[1, k] - joint[2, k]
        joint[1, k] -= joint[3, k]
        joint[2, k] -= joint[3, k]
    for k in range(4):
        joint[k, 0] += joint[k, 3] - joint[k, 1] - joint[k, 2]
        joint[k, 1] -= joint[k, 3]
        joint[k, 2] -= joint[k, 3]


@njit(cache=True, nogil=True)
def _count(source: Any, truth: Planes, counts: NDArray[np.int64], schedule: Any, outs: Any) -> np.uint64:
    """Write the counts of each ring and add the column counts if requested; return not 0 if a voxel is above 3."""
    runs, chunks, overhead = schedule
    low, high, beyond = np.zeros(CHUNK, np.uint32), np.zeros(CHUNK, np.uint32), np.uint64(0)
    joint, bev = np.zeros((counts.shape[0], 4, 4), np.int64), np.zeros((counts.shape[0], 3), np.int64)
    columns = truth.view(np.uint32)
    for c in range(chunks.shape[0]):
        ring, start, stop, end, first, last = chunks[c]
        beyond |= _pack(source, runs[first:last], low, high, columns)
        a, b, words = start // 2, stop // 2, (stop - start) // 2
        packed_low, packed_high = low.view(np.uint64)[:words], high.view(np.uint64)[:words]
        _joint(truth[0, a:b], truth[1, a:b], truth[2, a:b], packed_low, packed_high, joint[ring])
        truth_columns = (columns[0, start:stop], columns[1, start:stop])
        _drivable(truth_columns, columns[2, start:stop], low[: stop - start], high[: stop - start], bev[ring])
        for _ in range(min(outs[2].shape[0], 1)):
            predicted, taken = (low[: end - start], high[: end - start]), (columns[0, start:end], columns[1, start:end])
            count_pairs(taken, columns[2, start:end], predicted, outs[2][ring])
            count_columns(taken, columns[2, start:end], predicted, (overhead, outs[3][ring]))
    for ring in range(counts.shape[0]):
        joint[ring, :, 0] = counts[ring]
        _exact(joint[ring])
        outs[0][ring] = joint[ring]
        bev[ring, 1:] -= bev[ring, 0]
        outs[1][ring] = bev[ring]
    return beyond


def truth_planes(
    grid: Grid, is_evaluated: NDArray[np.bool_], label_grid: LabelGrid = PAPER, is_late: NDArray[np.bool_] | None = None
) -> TruthPlanes:
    """Prepare ground truth for counting; voxels that are not evaluated are never counted.

    Raises `ShapeError` for other shapes than the label grid's and `LabelRangeError` for values above 3.
    """
    if is_evaluated.shape != label_grid.shape:
        raise ShapeError("is_evaluated", is_evaluated.shape, str(label_grid.shape))
    low, high = _sorted_planes(grid, label_grid)
    valid, _ = _sorted_planes(is_evaluated.astype(np.uint8), label_grid)
    late = None if is_late is None else _sorted_planes(is_late.astype(np.uint8), label_grid)[0]
    return replace(truth_of_planes(np.stack([low & valid, high & valid, valid]), label_grid), late=late)


def truth_of_planes(planes: Planes, label_grid: LabelGrid = PAPER) -> TruthPlanes:
    """Return the ground truth with these planes. Raises `ShapeError` if they do not match the label grid."""
    layout, counts = layout_of(label_grid), np.zeros((RINGS, 4), np.int64)
    if planes.shape != (3, layout.words):
        raise ShapeError("planes", planes.shape, f"(3, {layout.words}) for {label_grid}")
    _count_truth(planes, layout.bounds, counts)
    return TruthPlanes(planes, counts, label_grid)


NO_COLUMN_COUNTS = ColumnCounts(np.empty((0, CLASSES), np.int32), np.empty((0, CLASSES, CLASSES), np.int32))


def count_by_ring(
    prediction: Grid,
    truth: TruthPlanes,
    confusion_out: Confusion,
    bev_out: Drivable,
    columns_out: ColumnCounts = NO_COLUMN_COUNTS,
) -> None:
    """Write the confusion matrices (3, 4, 4) and the drivable columns (3, 3) of one frame, over the evaluated voxels.

    Column counts are added to `columns_out` if it is given. Raises `ShapeError` for other shapes than the truth's grid
    and `LabelRangeError` for values above 3, evaluated or not; the outputs are then invalid.
    """
    outs = (confusion_out, bev_out, columns_out.pairs, columns_out.columns)
    grid, layout = truth.grid, layout_of(truth.grid)
    schedule = (layout.runs, layout.chunks, overhead_voxels(grid.voxel_m))
    source = _voxels(prediction, grid), grid.shape[2]
    if _count(source, truth.planes, truth.counts, schedule, outs):
        raise LabelRangeError(int(prediction.max()))


def frame_counts(prediction: Grid, truth: TruthPlanes) -> FrameCounts:
    """Return the results of `count_by_ring` as a value. Raises the same errors."""
    confusion, bev = np.empty((RINGS, CLASSES, CLASSES), np.int32), np.empty((RINGS, 3), np.int32)
    counts = FrameCounts(confusion, bev, no_column_counts(()))
    count_by_ring(prediction, truth, confusion, bev, counts.column_counts)
    return counts


def late_confusion(prediction: Grid, truth: TruthPlanes) -> Confusion:
    """Return the confusion matrix (4, 4) of the evaluated late voxels, or 0 if late voxels are unknown.

    Raises the errors of `count_by_ring`.
    """
    if truth.late is None:
        return np.zeros((CLASSES, CLASSES), np.int32)
    late = frame_counts(prediction, truth_of_planes(truth.planes & truth.late, truth.grid))
    return np.asarray(late.confusion.sum(axis=0, dtype=np.int32))


def _sorted_planes(grid: Grid, label_grid: LabelGrid) -> tuple[Planes, Planes]:
    layout = layout_of(label_grid)
    planes = np.zeros((2, layout.columns), np.uint32)
    if _pack((_voxels(grid, label_grid), label_grid.shape[2]), layout.runs, planes[0], planes[1], planes[:0]):
        raise LabelRangeError(int(grid.max()))
    low, high = planes.view(np.uint64)
    return low, high


def _voxels(grid: Grid, label_grid: LabelGrid) -> Grid:
    if grid.shape != label_grid.shape or grid.dtype != np.uint8:
        raise ShapeError("a label grid", grid.shape, f"{label_grid.shape} of uint8 (not {grid.dtype})")
    voxels = np.ascontiguousarray(grid).reshape(-1)
    voxels.flags.writeable = False  # read-only like a buffer read from a file, so one compiled kernel serves both
    return voxels
