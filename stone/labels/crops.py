"""The columns of one frame: cut from the labelled map, turned into the ego frame.

**Conventions.** An ego voxel takes the class of the map voxel that holds its centre. Where the straight way between
two neighbouring centres crosses a labelled map voxel that neither centre hits, the nearer of the two takes its class
(`stone.labels.pinholes`): so a surface closed in the map stays closed in the grid, whatever the yaw, pitch and roll.

Positions are fixed-point map voxels of `FRACTION_BITS`. Along a column the map's column and the height over it stay
the same for a stretch, which is fetched in one go.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.geometry.se3 import SE3
from stone.kernels.lanes import fetch, lowest, prefetch
from stone.labels.columns import Columns
from stone.labels.grid import BELOW, GRID_MIN_M, GRID_SHAPE, Window
from stone.labels.pinholes import FRACTION_BITS, NOT_ASKED, ONE, close_row, parted
from stone.labels.voxels import VOXEL_M

AHEAD = 8  # columns
ALL = np.uint32(0xFFFFFFFF)


@dataclass(frozen=True, eq=False)
class CropPlacement:
    """Fixed-point position in the window of voxel [0, 0, 0]'s centre, `start` (3,), and its change by one voxel along
    each ego axis, the columns of `step` (3, 3)."""

    start: NDArray[np.int64]
    step: NDArray[np.int64]


def placing_of(window: Window, map_from_ego: SE3) -> CropPlacement:
    """Where the voxels of a frame lie in the window."""
    scaled = map_from_ego.as_matrix() / VOXEL_M
    scaled[:3, 3] -= window.origin
    first = scaled[:3, 3].copy()
    for axis in range(3):
        first += scaled[:3, axis] * (GRID_MIN_M[axis] + 0.5 * VOXEL_M)
    return CropPlacement(
        np.rint(first * ONE).astype(np.int64), np.rint(scaled[:3, :3] * VOXEL_M * ONE).astype(np.int64)
    )


def cut(window: Window, map_from_ego: SE3, taken: NDArray[np.int32] = NOT_ASKED) -> Columns:
    """The columns of the frame at this pose; outside the window all is free and unobserved.

    `taken`, if asked for, (256, 256, 32, 3): where a voxel closes a gap, the voxel of the window it is labelled by.
    """
    placing = placing_of(window, map_from_ego)
    cells = np.zeros((*GRID_SHAPE[:2], 4), np.uint32)
    ones, twos, observed = (np.empty(GRID_SHAPE[:2], np.uint32) for _ in range(3))
    _cut(window.planes, window.height, (placing.start, placing.step), (cells, ones, twos, observed, taken))
    return Columns(ones, twos, observed)


@njit(cache=True, nogil=True)
def _cut(planes, height, place, out):  # type: ignore[no-untyped-def]
    """A row of columns is closed as soon as it is fetched, while the map around it is near."""
    cells = out[0]
    for a in range(cells.shape[0]):
        _fetch_row(planes, height, place, (a, cells))
        close_row(planes, place, (a, cells), out[1:])


@njit(cache=True, nogil=True)
def _fetch_row(planes, height, place, row):  # type: ignore[no-untyped-def]
    """Fill row `a` of `cells` (256, 256, 4), the planes of the window."""
    (start, step), (a, cells) = place, row
    su, sv, sw = step[0, 2], step[1, 2], step[2, 2] - ONE
    bu, bv, bw = step[0, 1], step[1, 1], step[2, 1]  # read once: for all the compiler knows, cells may lie over them
    u0, v0, w0 = start[0] + a * step[0, 0], start[1] + a * step[1, 0], start[2] + a * step[2, 0]
    flat, to, words = planes.reshape(-1), cells.reshape(-1), planes.shape[2]
    for b in range(cells.shape[1]):
        u, v, w = u0 + b * bu, v0 + b * bv, w0 + b * bw
        _prefetch(flat, planes.shape, (u + AHEAD * bu, v + AHEAD * bv, w + AHEAD * bw))
        breaks = parted(u, su, su) | parted(v, sv, sv) | parted(w, sw, sw)
        left = breaks | np.uint32(1)
        while left:
            c = lowest(left)
            stretch = ALL << np.uint32(c)
            left &= left - np.uint32(1)
            if left:
                stretch ^= ALL << np.uint32(lowest(left))
            i, j = (u + c * su) >> FRACTION_BITS, (v + c * sv) >> FRACTION_BITS
            k = ((w + c * sw) >> FRACTION_BITS) + BELOW
            if 0 <= i < planes.shape[0] and 0 <= j < planes.shape[1] and 0 <= k <= height + BELOW:
                at = ((i * planes.shape[1] + j) * words + (k >> 5)) * 4
                fetch(flat, at, np.uint32(k & 31), stretch, to, (a * cells.shape[1] + b) * 4)


@njit(inline="always")
def _prefetch(flat, shape, at):  # type: ignore[no-untyped-def]
    """The turned grid walks across the map where no hardware foresees it: this halves the time."""
    i, j, k = at[0] >> FRACTION_BITS, at[1] >> FRACTION_BITS, (at[2] >> FRACTION_BITS) + BELOW
    begin = ((i * shape[1] + j) * shape[2] + (k >> 5)) * 4
    prefetch(flat, begin)
    prefetch(flat, begin + 7)
