"""Patches: the surface in one cell as a mean point and a normal.

**Conventions.** Cells are those of `stone.surface.contour`: their corners are voxel centres. A patch's plane is fitted
to the k points nearest to its mean point, in any cells; its normal points to the side it was seen from. Patches are
sorted by cell. Points without enough neighbours for a plane form no patch.

Ground is seen at 2° or less, and a plane through sparse, noisy points tilts by more than that, so the plane does not
determine the seen side. The sensor's height does: nearly flat surfaces seen from above are ground. Surfaces seen from
below at such an angle are rising ground, unless there is something below them: then they are undersides.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone.geometry.lattice import MASK, Keys, keys_of
from stone.surface.neighbours import cells_of, plane_fits_at

FLAT_COSINE = 0.8  # 37°
GRAZING_SINE = 0.35  # 20°: the tilt of planes through sparse rings
BELOW_CELLS = 3


@dataclass(frozen=True, eq=False)
class Patches:
    """C cells: `cells` (C,) sorted keys, mean points (C, 3), unit `normals` (C, 3), and the number of points of
    each.
    """

    width_m: float
    cells: Keys
    points_map: NDArray[np.float64]
    normals: NDArray[np.float64]
    counts: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.cells)

    def where(self, keep: NDArray[np.bool_]) -> "Patches":
        points_map, normals = (np.compress(keep, rows, axis=0) for rows in (self.points_map, self.normals))
        return Patches(self.width_m, self.cells[keep], points_map, normals, self.counts[keep])


def patches_of(
    points_map: NDArray[np.float64], views_map: NDArray[np.float64], width_m: float, neighbours: int
) -> tuple[Patches, NDArray[np.bool_]]:
    """Return the patches of points (N, 3) seen from `views_map` (N, 3), and which points (N,) they contain.

    Patches exclude points that are too few for a plane, and mirror returns (below).
    """
    shift_m = 0.5 * width_m
    cells = cells_of(points_map - shift_m, width_m)
    counts = np.diff(cells.start)
    means = _sums(cells.points, cells.start) / counts[:, None]
    fits = plane_fits_at(cells, means, neighbours)
    views = _sums(views_map[cells.order], cells.start)
    normals = _seen_side(fits.normals, views, cells.keys)
    is_mirrored = mirror_returns(cells.keys, width_m, means, normals, views / counts[:, None], fits.mean_square_m2)
    is_patch = np.isfinite(fits.mean_square_m2) & ~is_mirrored
    is_in_patch = np.empty(len(points_map), np.bool_)
    is_in_patch[cells.order] = np.repeat(is_patch, counts)
    patches = Patches(width_m, cells.keys, means + shift_m, normals, counts)
    return patches.where(is_patch), is_in_patch


def _seen_side(normals: NDArray[np.float64], views: NDArray[np.float64], cells: Keys) -> NDArray[np.float64]:
    """Return the normals (C, 3), of either sign, on the side that was seen from the directions `views` (C, 3)."""
    towards = np.einsum("ci,ci->c", normals, views)
    facing = np.where(towards[:, None] < 0, -normals, normals)
    is_flat = np.abs(facing[:, 2]) >= FLAT_COSINE
    is_grazing = np.abs(towards) <= GRAZING_SINE * np.linalg.norm(views, axis=1)
    is_from_above, has_below = views[:, 2] > 0, _has_below(cells)
    is_up = is_flat & (is_from_above | (is_grazing & ~has_below))
    is_down = is_flat & is_grazing & ~is_from_above & has_below
    is_wrong = np.where(facing[:, 2] < 0, is_up, is_down)
    return np.where(is_wrong[:, None], -facing, facing)


def _has_below(cells: Keys) -> NDArray[np.bool_]:
    """Return which of the sorted cells (C,) have another cell of their column some cells below; z is the lowest part of
    a key.
    """
    height = cells & MASK
    is_lowest = np.append(True, np.diff(cells - height) != 0)[: len(cells)]
    first = np.maximum.accumulate(np.where(is_lowest, np.arange(len(cells)), 0))
    return np.asarray(height - height[first] >= BELOW_CELLS)


def _sums(rows: NDArray[np.float64], start: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the sum of the rows (N, 3) of each non-empty cell (C, 3)."""
    if len(start) == 1:
        return np.zeros((0, 3))
    return np.asarray(np.add.reduceat(rows, start[:-1], axis=0))


# Mirror returns: reflections on wet or polished ground, which a LiDAR places below it. A sheet is a patch that is flat,
# smooth and seen from above, like reflecting ground. Points that were seen through a sheet below it do not exist,
# because rays do not pass through ground. Ground under a table, a car or a bridge is also below a sheet, but is seen
# past its edge. Therefore the outermost patches of a sheet do not count, and neither do patches seen from many sides,
# because rays are traced to the mean viewing direction.


MIRROR_FLAT_COSINE = 0.9  # 26°
SMOOTH_M = 0.05
ONE_SIDE = 0.95  # length of the mean of unit directions: within about 18°
NEAREST_M, FARTHEST_M = 0.3, 3.0  # below the sheet: smaller distances are its own roughness
RISE_M = 0.05
COLUMN = ~MASK

Array = NDArray[np.float64]


def mirror_returns(
    cells: Keys, width_m: float, means_map: Array, normals: Array, views: Array, mean_square_m2: Array
) -> NDArray[np.bool_]:
    """Return which patches (C,) are below ground through which they were seen.

    `cells` (C,) are sorted keys of `width_m`. Each has a mean point (C, 3), a normal (C, 3) on the seen side and a mean
    unit viewing direction (C, 3). `mean_square_m2` (C,) is the mean squared distance of its points to their plane, NaN
    without a plane.
    """
    is_sheet = (normals[:, 2] >= MIRROR_FLAT_COSINE) & (views[:, 2] > 0) & (mean_square_m2 <= SMOOTH_M**2)
    is_seen_from_above = (views[:, 2] > 0) & (np.linalg.norm(views, axis=1) >= ONE_SIDE)
    rows = np.flatnonzero(is_seen_from_above & _has_above(cells, is_sheet))
    is_sheet[is_sheet] = _is_within(cells[is_sheet])
    sheets = cells[is_sheet], means_map[is_sheet, 2]
    rows = rows[_meets(sheets, width_m, means_map[rows], np.broadcast_to([0.0, 0.0, 1.0], (len(rows), 3)))]
    rows = rows[_meets(sheets, width_m, means_map[rows], views[rows])]
    is_mirrored = np.zeros(len(cells), np.bool_)
    is_mirrored[rows] = True
    return is_mirrored


def _is_within(sheets: Keys) -> NDArray[np.bool_]:
    """Return which of the sorted cells (S,) have neighbours on all four sides, at most one cell higher or lower."""
    within, padded = np.ones(len(sheets), np.bool_), np.append(sheets, np.iinfo(np.int64).max)
    for aside in (1 << 42, -(1 << 42), 1 << 21, -(1 << 21)):
        lowest = np.searchsorted(sheets, sheets + (aside - 1))  # heights are consecutive in a key
        within &= padded[lowest] <= sheets + (aside + 1)
    return within


def _has_above(cells: Keys, is_sheet: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which cells (C,) have a sheet in their column at or above them."""
    columns, sheets = cells & COLUMN, cells[is_sheet]
    following = np.searchsorted(sheets, cells)
    padded = np.append(sheets, -1)
    return np.asarray((padded[following] & COLUMN) == columns)


def _meets(sheets: tuple[Keys, Array], width_m: float, points_map: Array, directions: Array) -> NDArray[np.bool_]:
    """Return which rays from the points (R, 3) pass upwards through a sheet, given as sorted cells and heights (S,);
    directions (R, 3) point upwards.
    """
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
