"""Late voxels: voxels of a frame that only later sweeps observed, so that no method can see them at the frame's time.

**Conventions.** A brick (`stone.labels.observed_voxels`) is seen since the first frame whose rays touched it. A voxel
of a frame is late if the brick that contains its centre is first seen in a later frame. A voxel between two rays of a
sweep is therefore not late, and neither is a voxel in a brick without rays. A voxel of a pooled grid is late if all of
its observed map voxels are late.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.geometry.lattice import indices_of
from stone.geometry.se3 import SE3
from stone.kernels.lanes import lowest
from stone.labels.columns import Columns, Words, nothing
from stone.labels.crops import placing_of
from stone.labels.grid import Window
from stone.labels.observed_voxels import Observed
from stone.labels.pinholes import FRACTION_BITS
from stone.labels.pooling import pooled
from stone_base.label_grid import LabelGrid

BRICK_BITS = 2
NEVER_SEEN = np.int32(-1)


@dataclass(frozen=True, eq=False)
class FirstSeen:
    """The first frame of each brick around a window, `NEVER_SEEN` for a brick without rays.

    `origin` (3,) int64 is the index of brick [0, 0, 0]; `frames` covers all voxels of the window, and `last` (X, Y) is
    the maximum over each column of bricks.
    """

    origin: NDArray[np.int64]
    frames: NDArray[np.int32]
    last: NDArray[np.int32]


def first_seen(observed: Observed, window: Window) -> FirstSeen:
    """Return the first frame of each brick of a window; bricks outside the window are left out."""
    low = window.origin >> BRICK_BITS
    high = (window.origin + np.array(window.voxels.shape) - 3 >> BRICK_BITS) + 1
    frames = np.full(tuple(high - low), NEVER_SEEN, np.int32)
    places = indices_of(observed.keys) - low
    is_inside = ((places >= 0) & (places < high - low)).all(axis=1)
    frames[tuple(places[is_inside].T)] = observed.since[is_inside]
    return FirstSeen(low, frames, frames.max(axis=2))


def late_columns(
    fine: Columns, window: Window, map_from_ego: SE3, seen: tuple[FirstSeen, int], grid: LabelGrid
) -> Words:
    """Return the late voxels (X, Y) of a grid at this pose; `fine` are its columns at the map's voxel size.

    `seen` contains the bricks and the first frame that counts as later.
    """
    (first, later), placing = seen, placing_of(window, map_from_ego, grid.on_map)
    early = np.zeros_like(fine.ones)
    start = placing.start + (window.origin - (first.origin << BRICK_BITS) << FRACTION_BITS)
    _mark_early((fine.observed, fine.ones, fine.twos), (start, placing.step), (first.frames, first.last, later), early)
    none = nothing(early.shape)
    whole = pooled(Columns(none, none, fine.observed | fine.occupied), grid).observed
    return np.asarray(whole & ~pooled(Columns(none, none, early), grid).observed)


@njit(inline="always")
def _is_early(last, brick, later):  # type: ignore[no-untyped-def]
    """Return whether every brick of this column of bricks is seen before frame `later`, or never."""
    i, j = brick
    is_inside = (i >= 0) & (j >= 0) & (i < last.shape[0]) & (j < last.shape[1])
    return not is_inside or last[i, j] < later


@njit(cache=True, nogil=True)
def _mark_early(columns, place, seen, early):  # type: ignore[no-untyped-def]
    """Set the observed or labelled voxels of the columns that are not late; a brick outside counts as never seen."""
    (observed, low_plane, high_plane), (start, step), (frames, last, later) = columns, place, seen
    shift = FRACTION_BITS + BRICK_BITS
    for a in range(early.shape[0]):
        for b in range(early.shape[1]):
            left = observed[a, b] | low_plane[a, b] | high_plane[a, b]
            u = start[0] + a * step[0, 0] + b * step[0, 1]
            v = start[1] + a * step[1, 0] + b * step[1, 1]
            w = start[2] + a * step[2, 0] + b * step[2, 1]
            early_bits = left
            if _is_early(last, (u >> shift, v >> shift), later):
                i, j = (u + 31 * step[0, 2]) >> shift, (v + 31 * step[1, 2]) >> shift
                is_steep = abs(i - (u >> shift)) + abs(j - (v >> shift)) <= 1  # otherwise it may cross further bricks
                if is_steep and _is_early(last, (i, j), later):
                    left = np.uint32(0)
            while left:
                c = lowest(left)
                left &= left - np.uint32(1)
                i, j, k = (u + c * step[0, 2]) >> shift, (v + c * step[1, 2]) >> shift, (w + c * step[2, 2]) >> shift
                is_inside = (i >= 0) & (j >= 0) & (k >= 0)
                is_inside &= (i < frames.shape[0]) & (j < frames.shape[1]) & (k < frames.shape[2])
                if is_inside and frames[i, j, k] >= later:
                    early_bits &= ~(np.uint32(1) << np.uint32(c))
            early[a, b] = early_bits
