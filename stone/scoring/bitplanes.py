"""Confusion of label grids by bit planes and population counts: exact integers, one to two memory passes.

**Conventions.** A grid is (256, 256, 32) uint8, z fastest, classes 0–3. Class bits split into a low and a high plane
of one bit a voxel; a column (32 voxels along z) is one uint32. Columns are sorted by ring — the horizontal distance of
the column's centre from the ego origin, half-open: 0–10, 10–20, from 20 m — so that each ring is one contiguous run of
words. Truth planes are ANDed with the plane of evaluated voxels beforehand. Confusions are [ring, truth, prediction].
Seen from above, a column is drivable where its evaluated voxels hold a T or P and no N; columns drivable in both, in
the truth only and in the prediction only are counted [ring, 3]. The counts of `stone.scoring.columns` are made of the
same planes where they are wanted.

Source: counts of unions from counts of intersections by inclusion–exclusion; the planes are a bitmap index (O'Neil and
Quass, 1997).
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.errors import ShapeError, StoneError
from stone.kernels.column_words import drivable32, pack1, pack8
from stone.kernels.lanes import popcount, prefetch
from stone.labels.grid import GRID_SHAPE, Grid
from stone.labels.voxels import VOXEL_M
from stone.scoring.columns import count_columns, count_pairs
from stone.scoring.metric import CLASSES
from stone_base.label_grid import VOXELS as VOXELS

RING_EDGES_M = (10.0, 20.0)
RINGS = len(RING_EDGES_M) + 1
COLUMNS = VOXELS // 32
WORDS = VOXELS // 64

Planes = NDArray[np.uint64]
Columns = NDArray[np.uint32]
Confusion = NDArray[np.int32]
Drivable = NDArray[np.int32]


class LabelRangeError(StoneError):
    """A grid holds a value that is no class."""

    code = "label_out_of_range"

    def __init__(self, value: int) -> None:
        self.value = value
        super().__init__(
            f"a voxel holds {value}; classes are 0 to 3 (is 'unknown' written as 255, or another class map?)"
        )


@dataclass(frozen=True, eq=False)
class TruthPlanes:
    """Ground truth of one frame, ring-sorted: `planes` (3, WORDS) = low, high, evaluated.

    `counts` (3, 4) are, by ring, the voxels evaluated and those with the low, the high and both bits set.
    """

    planes: Planes
    counts: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class ColumnCounts:
    """The counts of `stone.scoring.columns`: `pairs` (…, 3, 4) [ring, set], `columns` (…, 3, 4, 4) as a confusion."""

    pairs: NDArray[np.int32]
    columns: Confusion

    def of_frame(self, index: int) -> "ColumnCounts":
        """Return those of one of several frames, as a view."""
        return ColumnCounts(self.pairs[index], self.columns[index])


@dataclass(frozen=True, eq=False)
class FrameCounts:
    """What is kept of a frame: `confusion` (3, 4, 4) [ring, truth, prediction] in voxels, `bev` (3, 3) in columns."""

    confusion: Confusion
    bev: Drivable
    column_counts: ColumnCounts


def column_rings() -> NDArray[np.int64]:
    """Ring of each column (65536,), x slowest."""
    half = [(np.arange(n) - n / 2 + 0.5) * VOXEL_M for n in GRID_SHAPE[:2]]
    distance_m = np.hypot(half[0][:, None], half[1][None, :])
    return np.asarray(np.digitize(distance_m, RING_EDGES_M).ravel(), dtype=np.int64)


_ORDER = np.argsort(column_rings(), kind="stable")
_BOUNDS = np.concatenate([[0], np.cumsum(np.bincount(column_rings(), minlength=RINGS))])
# Columns counted at a time: their planes, 32 KiB, stay in the nearest cache and cost no page faults.
_CHUNK = 4096


def _schedule() -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Runs (source column, target column, length) of the sort, and chunks (ring, start, stop, first run, last run)."""
    starts = np.concatenate([np.arange(low, high, _CHUNK) for low, high in pairwise(_BOUNDS)])
    stops = np.append(starts[1:], COLUMNS)
    breaks = np.unique(np.concatenate([[0], np.flatnonzero(np.diff(_ORDER) != 1) + 1, starts]))
    runs = np.stack([_ORDER[breaks], breaks, np.diff(np.append(breaks, COLUMNS))], axis=1)
    rings = np.searchsorted(_BOUNDS, starts, side="right") - 1
    chunks = np.stack([rings, starts, stops, np.searchsorted(breaks, starts), np.searchsorted(breaks, stops)], axis=1)
    return runs.astype(np.int64), chunks.astype(np.int64)


_RUNS, _CHUNKS = _schedule()


@njit(cache=True, nogil=True)
def _pack(voxels: Grid, runs: NDArray[np.int64], low: Columns, high: Columns, wanted: Columns) -> np.uint64:
    """Both planes of the columns in `runs`, sorted, from 0 on; not 0 if a voxel is above 3.

    Packing leaves the memory idle, so that the same columns of `wanted` (planes, columns) are brought near meanwhile.
    """
    origin = runs[0, 1]
    beyond = np.uint64(0)
    for r in range(runs.shape[0]):
        source, target, columns = runs[r, 0], runs[r, 1] - origin, runs[r, 2]
        many = columns - columns % 8
        for i in range(0, many, 8):
            beyond |= pack8(voxels, 32 * (source + i), low, high, target + i)
            for plane in range(wanted.shape[0]):
                prefetch(wanted, plane * wanted.shape[1] + target + origin + i)
        for i in range(many, columns):
            beyond |= pack1(voxels, 32 * (source + i), low, high, target + i)
    return beyond


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
    """Counts [truth, prediction] of (any, low, high, both) added; truth "any" only of the prediction."""
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
    """Columns drivable in (both, truth, prediction) added; one uint32 a column, their number a multiple of 2."""
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
    """Inclusion–exclusion in place: counts of (any, low, high, both) become counts of classes 0–3, on both axes."""
    for k in range(4):
        joint[0, k] += joint[3, k] - joint[1, k] - joint[2, k]
        joint[1, k] -= joint[3, k]
        joint[2, k] -= joint[3, k]
    for k in range(4):
        joint[k, 0] += joint[k, 3] - joint[k, 1] - joint[k, 2]
        joint[k, 1] -= joint[k, 3]
        joint[k, 2] -= joint[k, 3]


@njit(cache=True, nogil=True)
def _count(voxels: Grid, truth: Planes, counts: NDArray[np.int64], schedule: Any, outs: Any) -> np.uint64:
    """The counts of each ring, added to the column counts if these have rings; returns not 0 if a voxel is above 3."""
    runs, chunks = schedule
    low, high, beyond = np.empty(_CHUNK, np.uint32), np.empty(_CHUNK, np.uint32), np.uint64(0)
    joint, bev = np.zeros((counts.shape[0], 4, 4), np.int64), np.zeros((counts.shape[0], 3), np.int64)
    columns = truth.view(np.uint32)
    for c in range(chunks.shape[0]):
        ring, start, stop, first, last = chunks[c]
        beyond |= _pack(voxels, runs[first:last], low, high, columns)
        a, b, words = start // 2, stop // 2, (stop - start) // 2
        packed_low, packed_high = low.view(np.uint64)[:words], high.view(np.uint64)[:words]
        _joint(truth[0, a:b], truth[1, a:b], truth[2, a:b], packed_low, packed_high, joint[ring])
        truth_columns = (columns[0, start:stop], columns[1, start:stop])
        _drivable(truth_columns, columns[2, start:stop], low[: stop - start], high[: stop - start], bev[ring])
        for _ in range(min(outs[2].shape[0], 1)):
            predicted = low[: stop - start], high[: stop - start]
            count_pairs(truth_columns, columns[2, start:stop], predicted, outs[2][ring])
            count_columns(truth_columns, columns[2, start:stop], predicted, outs[3][ring])
    for ring in range(counts.shape[0]):
        joint[ring, :, 0] = counts[ring]
        _exact(joint[ring])
        outs[0][ring] = joint[ring]
        bev[ring, 1:] -= bev[ring, 0]
        outs[1][ring] = bev[ring]
    return beyond


def no_column_counts(shape: tuple[int, ...]) -> ColumnCounts:
    """Column counts of frames of this shape, all zero."""
    return ColumnCounts(
        np.zeros((*shape, RINGS, CLASSES), np.int32), np.zeros((*shape, RINGS, CLASSES, CLASSES), np.int32)
    )


def truth_planes(grid: Grid, is_evaluated: NDArray[np.bool_]) -> TruthPlanes:
    """Ground truth made ready: voxels that are not evaluated count nowhere.

    Raises `ShapeError` for other shapes than (256, 256, 32) and `LabelRangeError` for values above 3.
    """
    if is_evaluated.shape != GRID_SHAPE:
        raise ShapeError("is_evaluated", is_evaluated.shape, str(GRID_SHAPE))
    low, high = _sorted_planes(grid)
    valid, _ = _sorted_planes(is_evaluated.astype(np.uint8))
    planes = np.stack([low & valid, high & valid, valid])
    counts = np.zeros((RINGS, 4), np.int64)
    _count_truth(planes, _BOUNDS, counts)
    return TruthPlanes(planes, counts)


NO_COLUMN_COUNTS = ColumnCounts(np.empty((0, CLASSES), np.int32), np.empty((0, CLASSES, CLASSES), np.int32))


def count_by_ring(
    prediction: Grid,
    truth: TruthPlanes,
    confusion_out: Confusion,
    bev_out: Drivable,
    columns_out: ColumnCounts = NO_COLUMN_COUNTS,
) -> None:
    """Write the confusion (3, 4, 4) and the drivable columns (3, 3) of one frame, over the evaluated voxels.

    Column counts are added to `columns_out` if it is given. Raises `ShapeError` for other shapes than (256, 256, 32)
    and `LabelRangeError` for values above 3, evaluated or not; then what was written means nothing.
    """
    outs = (confusion_out, bev_out, columns_out.pairs, columns_out.columns)
    if _count(_voxels(prediction), truth.planes, truth.counts, (_RUNS, _CHUNKS), outs):
        raise LabelRangeError(int(prediction.max()))


def frame_counts(prediction: Grid, truth: TruthPlanes) -> FrameCounts:
    """What `count_by_ring` writes, as a value. Raises what it raises."""
    confusion, bev = np.empty((RINGS, CLASSES, CLASSES), np.int32), np.empty((RINGS, 3), np.int32)
    counts = FrameCounts(confusion, bev, no_column_counts(()))
    count_by_ring(prediction, truth, confusion, bev, counts.column_counts)
    return counts


def _sorted_planes(grid: Grid) -> tuple[Planes, Planes]:
    planes = np.empty((2, COLUMNS), np.uint32)
    if _pack(_voxels(grid), _RUNS, planes[0], planes[1], planes[:0]):
        raise LabelRangeError(int(grid.max()))
    low, high = planes.view(np.uint64)
    return low, high


def _voxels(grid: Grid) -> Grid:
    if grid.shape != GRID_SHAPE or grid.dtype != np.uint8:
        raise ShapeError("a label grid", grid.shape, f"{GRID_SHAPE} of uint8 (not {grid.dtype})")
    voxels = np.ascontiguousarray(grid).reshape(-1)
    voxels.flags.writeable = False  # as a buffer read from a file is: one compiled kernel serves both
    return voxels
