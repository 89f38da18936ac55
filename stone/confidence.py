"""How far each labelled voxel of a frame is from the driven ground: the D² its class was decided by (paper, Eq. 6).

**Conventions.** Float16, like D² squared and without unit: half a part in a thousand, as far as 65504, where it ends;
−1 where there is no surface. A voxel that closes a gap has the D² of the map voxel whose class it took.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.closing import FRACTION_BITS
from stone.columns import Columns
from stone.crops import cut, placing_of
from stone.grid import GRID_SHAPE, Window
from stone.lanes import lowest
from stone.lattice import Keys, Table, find, pack, table_of
from stone.se3 import SE3

NO_SURFACE = np.float16(-1.0)
MOST = float(np.finfo(np.float16).max)

Distances = NDArray[np.float16]


@dataclass(frozen=True, eq=False)
class MapDistances:
    """The D² of the labelled map voxels, found by their keys."""

    table: Table
    squared: NDArray[np.float16]


def map_distances(keys: Keys, squared: NDArray[np.float64]) -> MapDistances:
    """Of the labelled voxels `keys` (K,), their D² `squared` (K,)."""
    return MapDistances(table_of(keys), np.minimum(squared, MOST).astype(np.float16))


def cut_with_distances(window: Window, map_from_ego: SE3, distances: MapDistances) -> tuple[Columns, Distances]:
    """The columns of the frame at this pose, and the D² of every voxel, of `GRID_SHAPE`."""
    taken = np.full((*GRID_SHAPE, 3), np.iinfo(np.int32).min, np.int32)
    columns = cut(window, map_from_ego, taken)
    grid = np.full(GRID_SHAPE, NO_SURFACE)
    placing = placing_of(window, map_from_ego)
    table = (distances.table.keys, distances.table.rows, distances.squared)
    _look_up((columns.occupied, taken), (placing.start, placing.step, window.origin), table, grid)
    return columns, grid


@njit(cache=True, nogil=True)
def _look_up(labelled, place, table, grid):  # type: ignore[no-untyped-def]
    (occupied, taken), (start, step, origin), (keys, rows, squared) = labelled, place, table
    at = np.empty(3, np.int64)
    for a in range(grid.shape[0]):
        for b in range(grid.shape[1]):
            left = occupied[a, b]
            while left:
                c = lowest(left)
                left &= left - np.uint32(1)
                for r in range(3):
                    at[r] = (start[r] + a * step[r, 0] + b * step[r, 1] + c * step[r, 2]) >> FRACTION_BITS
                    if taken[a, b, c, 0] >= 0:
                        at[r] = taken[a, b, c, r]
                grid[a, b, c] = squared[find(keys, rows, pack(*(at + origin)))]
