"""Crops: a frame's columns and further voxel data, taken from the labelled map.

**Conventions.** An ego voxel of the map's size takes the class of the map voxel that contains its centre. If the
straight line between two neighbouring centres crosses a labelled map voxel that contains neither centre, the nearer ego
voxel takes its class (`stone.labels.pinholes`). A surface that is closed in the map therefore stays closed in the grid
for every yaw, pitch and roll.

A larger voxel is pooled from its map-size voxels (`stone.labels.pooling`).

Positions are fixed-point map voxels with `FRACTION_BITS`. One row of columns is processed for all frames of a batch
before the next row: neighbouring frames look up nearly the same map voxels.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.geometry.lattice import VoxelTable, find, pack
from stone.geometry.se3 import SE3
from stone.kernels.lanes import looked_up, lowest
from stone.labels.columns import Columns
from stone.labels.grid import Window
from stone.labels.pinholes import FRACTION_BITS, NOT_ASKED, ONE, close_row
from stone.labels.voxels import VOXEL_M
from stone_base.label_grid import PAPER, LabelGrid

UNTAKEN = np.iinfo(np.int32).min


def cut_with_rows(
    window: Window, map_from_ego: SE3, labelled: VoxelTable, grid: LabelGrid = PAPER
) -> tuple[Columns, NDArray[np.int32]]:
    """Return the frame's columns at this pose, and for every map-size voxel the row of the labelled map voxel that gave
    its class.

    The row is −1 without a surface. A voxel that closes a gap has its neighbour's row.
    """
    taken = np.full((*grid.shape, 3), UNTAKEN, np.int32)
    columns = cut(window, map_from_ego, taken, grid)
    rows = np.full(grid.shape, -1, np.int32)
    placing = placing_of(window, map_from_ego, grid)
    placement = (placing.start, placing.step, window.origin)
    _look_up((columns.occupied, taken), placement, (labelled.keys, labelled.rows), rows)
    return columns, rows


@njit(cache=True, nogil=True)
def _look_up(labelled, placement, table, grid):  # type: ignore[no-untyped-def]
    (occupied, taken), (start, step, origin), (keys, rows) = labelled, placement, table
    for a in range(grid.shape[0]):
        for b in range(grid.shape[1]):
            left = occupied[a, b]
            while left:
                c = lowest(left)
                left &= left - np.uint32(1)
                i = (start[0] + a * step[0, 0] + b * step[0, 1] + c * step[0, 2]) >> FRACTION_BITS
                j = (start[1] + a * step[1, 0] + b * step[1, 1] + c * step[1, 2]) >> FRACTION_BITS
                k = (start[2] + a * step[2, 0] + b * step[2, 1] + c * step[2, 2]) >> FRACTION_BITS
                if taken[a, b, c, 0] != UNTAKEN:
                    i, j, k = taken[a, b, c, 0], taken[a, b, c, 1], taken[a, b, c, 2]
                grid[a, b, c] = find(keys, rows, pack(i + origin[0], j + origin[1], k + origin[2]))


@dataclass(frozen=True, eq=False)
class CropPlacement:
    """Fixed-point positions in the window: `start` (3,) is the centre of voxel [0, 0, 0].

    The columns of `step` (3, 3) are the change per voxel along each ego axis.
    """

    start: NDArray[np.int64]
    step: NDArray[np.int64]


def placing_of(window: Window, map_from_ego: SE3, grid: LabelGrid = PAPER) -> CropPlacement:
    """Return the positions of a frame's voxels in the window."""
    scaled = map_from_ego.as_matrix() / VOXEL_M
    scaled[:3, 3] -= window.origin
    first = scaled[:3, 3].copy()
    for axis in range(3):
        first += scaled[:3, axis] * (grid.min_m[axis] + 0.5 * VOXEL_M)
    return CropPlacement(
        np.rint(first * ONE).astype(np.int64), np.rint(scaled[:3, :3] * VOXEL_M * ONE).astype(np.int64)
    )


def cut(window: Window, map_from_ego: SE3, taken: NDArray[np.int32] = NOT_ASKED, grid: LabelGrid = PAPER) -> Columns:
    """Return the frame's columns at this pose for a grid of map-size voxels; voxels outside the window are free and
    unobserved.

    If `taken` is given, its shape is the grid's plus 3; for each voxel that closes a gap, it receives the window voxel
    of its label.
    """
    return _cuts(window, [placing_of(window, map_from_ego, grid)], taken, grid.shape)[0]


def cut_batch(window: Window, map_from_ego: SE3, grid: LabelGrid = PAPER) -> list[Columns]:
    """Return the columns of the frames at these poses (F,), equal to `cut` of each."""
    placings = [placing_of(window, map_from_ego[frame], grid) for frame in range(len(map_from_ego))]
    return _cuts(window, placings, NOT_ASKED, grid.shape)


def _cuts(
    window: Window, placings: Sequence[CropPlacement], taken: NDArray[np.int32], shape: tuple[int, int, int]
) -> list[Columns]:
    starts, steps = np.array([placing.start for placing in placings]), np.array([placing.step for placing in placings])
    low_plane, high_plane, observed = (np.empty((len(placings), *shape[:2]), np.uint32) for _ in range(3))
    rows = np.empty((len(placings), 2, shape[1], 4), np.uint32)
    filled = np.zeros(len(placings), np.int64)
    _cut(window.voxels, (starts, steps), (rows, shape[2]), (low_plane, high_plane, observed, taken, filled))
    return [Columns(*words) for words in zip(low_plane, high_plane, observed, filled.tolist(), strict=True)]


@njit(cache=True, nogil=True)
def _cut(voxels, places, room, out):  # type: ignore[no-untyped-def]
    """Process each row of columns directly after fetching it, while the surrounding map is cached.

    `rows` (F, 2, Y, 4) are this row and the previous one, alternating, one word per bit of the window's voxels.
    """
    (starts, steps), (rows, height), (low_plane, high_plane, observed, taken, filled) = places, room, out
    used = np.uint32((np.uint64(1) << np.uint64(height)) - np.uint64(1))
    ways = np.empty(3 * 32 * rows.shape[2], np.int64)
    for a in range(low_plane.shape[1]):
        for f in range(low_plane.shape[0]):
            _fetch_row(voxels, (starts[f], steps[f]), (a, used), rows[f, a & 1])
            row = (a, rows[f], ways)
            filled[f] += close_row(
                voxels, (starts[f], steps[f]), row, (low_plane[f], high_plane[f], observed[f], taken)
            )


@njit(cache=True, nogil=True)
def _fetch_row(voxels, placement, used_bits, row):  # type: ignore[no-untyped-def]
    """Fill row a, (Y, 4), with `used_bits`; voxels outside the window are looked up in its outermost layer."""
    (start, step), (a, used) = placement, used_bits
    su, sv, sw = step[0, 2], step[1, 2], step[2, 2]
    bu, bv, bw = step[0, 1], step[1, 1], step[2, 1]  # copied first, because the row may alias them
    u, v, w = start[0] + a * step[0, 0] + ONE, start[1] + a * step[1, 0] + ONE, start[2] + a * step[2, 0] + ONE
    last = (voxels.shape[0] - 1, voxels.shape[1] - 1, voxels.shape[2] - 1)
    flat = voxels.reshape(-1)
    for b in range(row.shape[0]):
        centre = (u + b * bu, v + b * bv, w + b * bw)
        low, high, occupied, seen = looked_up(flat, last, centre, (su, sv, sw), FRACTION_BITS)
        row[b, 0], row[b, 1], row[b, 2], row[b, 3] = low & used, high & used, occupied & used, seen & used
