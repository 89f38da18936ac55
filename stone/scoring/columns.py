"""Counts by column: pairs of voxels at most one voxel apart in height, and columns that count once.

**Conventions.** A column is up to 32 voxels along z in the bits of a word, bit 0 the lowest. A class is the low and
high bit of two planes. These kernels are compiled for `stone.scoring.bitplanes`, which passes truth columns with
evaluated voxels only, and prediction columns that may contain others.

- *Pairs* of a set (occupied, T, P, N), per column: the smaller of two counts. One counts the truth voxels with a
  predicted voxel at most one voxel above or below, the other the predicted voxels with such a truth voxel. A surface
  one voxel too high pairs completely; a column of three voxels pairs with one voxel once.
- The *class of a column* is the worst (N, P, T, free) of its voxels. N voxels do not count if they are higher above the
  lowest T or P than the robot's height.

Both are counted in at most `COUNTED_FRAMES` evenly spaced frames of a submission (`frame_counts.py`). Neighbouring
frames overlap, and these counts take half as long as all other work on a frame.
"""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.kernels.lanes import popcount

_ONE = np.uint64(1)

Columns = NDArray[np.uint32]


@njit(cache=True, nogil=True)
def count_pairs(truth: Any, evaluated: Columns, prediction: Any, pairs: NDArray[np.int32]) -> None:
    """Add the pairs (4,) of occupied, T, P and N; truth and prediction are a low and a high plane each."""
    (truth_low, truth_high), (low, high) = truth, prediction
    occupied = t = p = n = np.uint64(0)
    for i in range(low.size):
        valid, g1, g2 = np.uint64(evaluated[i]), np.uint64(truth_low[i]), np.uint64(truth_high[i])
        p1, p2 = np.uint64(low[i]) & valid, np.uint64(high[i]) & valid
        g3, p3 = g1 & g2, p1 & p2
        occupied += _pairs(g1 | g2, p1 | p2)
        t += _pairs(g1 ^ g3, p1 ^ p3)
        p += _pairs(g2 ^ g3, p2 ^ p3)
        n += _pairs(g3, p3)
    pairs[0] += np.int64(occupied)
    pairs[1] += np.int64(t)
    pairs[2] += np.int64(p)
    pairs[3] += np.int64(n)


@njit(inline="always")
def _pairs(a: Any, b: Any) -> Any:
    return min(popcount(a & _thickened(b)), popcount(b & _thickened(a)))


@njit(inline="always")
def _thickened(column: Any) -> Any:
    """Return the column with the voxels above and below; the bit above the highest voxel has no effect."""
    return column | (column << _ONE) | (column >> _ONE)


@njit(cache=True, nogil=True)
def count_columns(truth: Any, evaluated: Columns, prediction: Any, out: Any) -> None:
    """Add the confusion matrix (4, 4) [truth, prediction] of columns; both are a low and a high plane.

    `out` are the number of `overhead_voxels` and the counts.
    """
    (truth_low, truth_high), (low, high), (voxels, counts) = truth, prediction, out
    overhead = np.uint64(voxels)
    s11 = s12 = s13 = s21 = s22 = s23 = s31 = s32 = s33 = np.uint64(0)
    t1 = t2 = t3 = q1 = q2 = q3 = np.uint64(0)
    for i in range(low.size):
        valid = np.uint64(evaluated[i])
        g1, g2, g3 = _class_of(np.uint64(truth_low[i]), np.uint64(truth_high[i]), overhead)
        p1, p2, p3 = _class_of(np.uint64(low[i]) & valid, np.uint64(high[i]) & valid, overhead)
        s11, s12, s13 = s11 + (g1 & p1), s12 + (g1 & p2), s13 + (g1 & p3)
        s21, s22, s23 = s21 + (g2 & p1), s22 + (g2 & p2), s23 + (g2 & p3)
        s31, s32, s33 = s31 + (g3 & p1), s32 + (g3 & p2), s33 + (g3 & p3)
        t1, t2, t3, q1, q2, q3 = t1 + g1, t2 + g2, t3 + g3, q1 + p1, q2 + p2, q3 + p3
    both = ((s11, s12, s13), (s21, s22, s23), (s31, s32, s33))
    in_truth, in_prediction = (t1, t2, t3), (q1, q2, q3)
    free = np.int64(low.size)
    for row in range(3):
        only_truth, only_prediction = np.int64(in_truth[row]), np.int64(in_prediction[row])
        free -= only_truth + only_prediction
        for column in range(3):
            counts[row + 1, column + 1] += np.int64(both[row][column])
            only_truth -= np.int64(both[row][column])
            only_prediction -= np.int64(both[column][row])
            free += np.int64(both[row][column])
        counts[row + 1, 0] += only_truth
        counts[0, row + 1] += only_prediction
    counts[0, 0] += free


@njit(inline="always")
def _class_of(low: Any, high: Any, overhead: Any) -> Any:
    """Return whether (0 or 1) a column is T, P, N; all 0 for a free column."""
    blocking = low & high
    surface = low ^ high
    lowest = surface & (~surface + _ONE)
    within_reach = (lowest << overhead) - _ONE  # all voxels if there is no surface
    is_n = np.uint64((blocking & within_reach) != 0)
    is_p = np.uint64((high & ~blocking) != 0) & (is_n ^ _ONE)
    is_t = np.uint64((low & ~blocking) != 0) & (is_n ^ _ONE) & (is_p ^ _ONE)
    return is_t, is_p, is_n
