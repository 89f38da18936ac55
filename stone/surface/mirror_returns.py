"""Mirror returns: what wet or polished ground throws back, and a LiDAR therefore places below it.

**Conventions.** A sheet is a patch that is flat, smooth and seen from above, as ground is that mirrors. What lies below
a sheet and was seen through one was never there: rays do not go through ground. Ground under a table, a car or a bridge
lies below a sheet too, but is seen past its edge: the outermost patches of a sheet do not count, and neither does what
was seen from many sides, for a ray is followed to where the patch was seen from on average.
"""

import numpy as np
from numpy.typing import NDArray

from stone.geometry.lattice import MASK, Keys, keys_of

FLAT_COSINE = 0.9  # 26°
SMOOTH_M = 0.05
ONE_SIDE = 0.95  # length of the mean of unit directions: within about 18°
NEAREST_M, FARTHEST_M = 0.3, 3.0  # below the sheet: nearer is its own roughness
RISE_M = 0.05
COLUMN = ~MASK

Array = NDArray[np.float64]


def mirror_returns(
    cells: Keys, width_m: float, means_map: Array, normals: Array, views: Array, mean_square_m2: Array
) -> NDArray[np.bool_]:
    """Which patches (C,) lie below ground through which they were seen.

    `cells` (C,) are sorted keys of `width_m`, each with its mean point (C, 3), normal (C, 3) on the side that was seen,
    mean of the unit directions (C, 3) it was seen from, and mean squared distance (C,) of its points to their plane,
    NaN without one.
    """
    is_sheet = (normals[:, 2] >= FLAT_COSINE) & (views[:, 2] > 0) & (mean_square_m2 <= SMOOTH_M**2)
    is_seen_from_above = (views[:, 2] > 0) & (np.linalg.norm(views, axis=1) >= ONE_SIDE)
    rows = np.flatnonzero(is_seen_from_above & _has_above(cells, is_sheet))
    is_sheet[is_sheet] = _is_within(cells[is_sheet])
    sheets = cells[is_sheet], means_map[is_sheet, 2]
    rows = rows[_meets(sheets, width_m, means_map[rows], np.broadcast_to([0.0, 0.0, 1.0], (len(rows), 3)))]
    rows = rows[_meets(sheets, width_m, means_map[rows], views[rows])]
    found = np.zeros(len(cells), np.bool_)
    found[rows] = True
    return found


def _is_within(sheets: Keys) -> NDArray[np.bool_]:
    """Which of the sorted cells (S,) have another beside them on all four sides, at most one higher or lower."""
    within, padded = np.ones(len(sheets), np.bool_), np.append(sheets, np.iinfo(np.int64).max)
    for aside in (1 << 42, -(1 << 42), 1 << 21, -(1 << 21)):
        lowest = np.searchsorted(sheets, sheets + (aside - 1))  # heights follow each other in a key
        within &= padded[lowest] <= sheets + (aside + 1)
    return within


def _has_above(cells: Keys, is_sheet: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which cells (C,) have a sheet in their column that is not below them."""
    columns, sheets = cells & COLUMN, cells[is_sheet]
    following = np.searchsorted(sheets, cells)
    padded = np.append(sheets, -1)
    return np.asarray((padded[following] & COLUMN) == columns)


def _meets(sheets: tuple[Keys, Array], width_m: float, points_map: Array, directions: Array) -> NDArray[np.bool_]:
    """Which rays from the points (R, 3) go up through a sheet, given as sorted cells and heights (S,); directions
    (R, 3) point upwards."""
    keys, heights_m = sheets
    met = np.zeros(len(points_map), np.bool_)
    if not len(keys) or not len(points_map):
        return met
    ways = directions / directions[:, 2:]
    for rise_m in np.arange(NEAREST_M, FARTHEST_M, RISE_M):
        near = keys_of(points_map + rise_m * ways, width_m)
        at = np.minimum(np.searchsorted(keys, near), len(keys) - 1)
        met |= (keys[at] == near) & (heights_m[at] - points_map[:, 2] >= NEAREST_M)
    return met
