"""Distance of each labelled voxel from the driven ground: the D² its class was decided by (paper, Eq. 6).

**Conventions.** Float16, without unit, to half a part in a thousand; 65504 stands for all beyond; −1 where there is no
surface. A voxel that closes a gap has the D² of the map voxel whose class it took. What was driven has its D² too.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.geometry.lattice import Keys, VoxelTable, find, pack, table_of
from stone.geometry.se3 import SE3
from stone.kernels.lanes import lowest
from stone.labels.columns import Columns
from stone.labels.crops import cut, placing_of
from stone.labels.grid import GRID_SHAPE, Window
from stone.labels.pinholes import FRACTION_BITS

NO_SURFACE = np.float16(-1.0)
UNTAKEN = np.iinfo(np.int32).min
MOST = float(np.finfo(np.float16).max)

Distances = NDArray[np.float16]


@dataclass(frozen=True, eq=False)
class MapDistances:
    """The D² of the labelled map voxels, found by their keys."""

    table: VoxelTable
    squared: NDArray[np.float16]


def map_distances(keys: Keys, squared: NDArray[np.float64]) -> MapDistances:
    """Of the labelled voxels `keys` (K,), their D² `squared` (K,)."""
    return MapDistances(table_of(keys), np.minimum(squared, MOST).astype(np.float16))


def cut_with_distances(window: Window, map_from_ego: SE3, distances: MapDistances) -> tuple[Columns, Distances]:
    """The columns of the frame at this pose, and the D² of every voxel, of `GRID_SHAPE`."""
    taken = np.full((*GRID_SHAPE, 3), UNTAKEN, np.int32)
    columns = cut(window, map_from_ego, taken)
    grid = np.full(GRID_SHAPE, NO_SURFACE)
    placing = placing_of(window, map_from_ego)
    table = (distances.table.keys, distances.table.rows, distances.squared.view(np.uint16))  # numba has no float16
    _look_up((columns.occupied, taken), (placing.start, placing.step, window.origin), table, grid.view(np.uint16))
    return columns, grid


@njit(cache=True, nogil=True)
def _look_up(labelled, place, table, grid):  # type: ignore[no-untyped-def]
    (occupied, taken), (start, step, origin), (keys, rows, squared) = labelled, place, table
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
                grid[a, b, c] = squared[find(keys, rows, pack(i + origin[0], j + origin[1], k + origin[2]))]
