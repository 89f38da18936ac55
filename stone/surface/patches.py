"""Patches: what the points of one cell say about the surface there, as a mean point and a normal.

**Conventions.** Cells are those of `stone.surface.band`: their corners are voxel centres. A patch's plane is that of
the k
points nearest to its mean point, whichever cells they lie in; its normal is on the side it was seen from. Patches are
sorted by cell. Points without enough neighbours for a plane make no patch.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone.geometry.lattice import Keys
from stone.surface.neighbours import cells_of, plane_fits_at


@dataclass(frozen=True, eq=False)
class Patches:
    """C cells: `cells` (C,) sorted keys, mean points (C, 3), unit `normals` (C, 3), and how many points each holds."""

    width_m: float
    cells: Keys
    points_map: NDArray[np.float64]
    normals: NDArray[np.float64]
    counts: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.cells)

    def where(self, keep: NDArray[np.bool_]) -> "Patches":
        return Patches(self.width_m, self.cells[keep], self.points_map[keep], self.normals[keep], self.counts[keep])


def patches_of(
    points_map: NDArray[np.float64], views_map: NDArray[np.float64], width_m: float, neighbours: int
) -> tuple[Patches, NDArray[np.bool_]]:
    """The patches of points (N, 3) seen from `views_map` (N, 3), and which points (N,) they are made of."""
    shift_m = 0.5 * width_m
    cells = cells_of(points_map - shift_m, width_m)
    counts = np.diff(cells.start)
    means = _sums(cells.points, cells.start) / counts[:, None]
    fits = plane_fits_at(cells, means, neighbours)
    has_plane = np.isfinite(fits.mean_square_m2)
    towards = np.einsum("ci,ci->c", fits.normals, _sums(views_map[cells.order], cells.start))
    normals = np.where(towards[:, None] < 0, -fits.normals, fits.normals)
    is_in_patch = np.empty(len(points_map), np.bool_)
    is_in_patch[cells.order] = np.repeat(has_plane, counts)
    patches = Patches(width_m, cells.keys, means + shift_m, normals, counts)
    return patches.where(has_plane), is_in_patch


def _sums(rows: NDArray[np.float64], start: NDArray[np.int64]) -> NDArray[np.float64]:
    """The sum of the rows (N, 3) of each cell (C, 3); none is empty."""
    if len(start) == 1:
        return np.zeros((0, 3))
    return np.asarray(np.add.reduceat(rows, start[:-1], axis=0))
