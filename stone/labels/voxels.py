"""Voxel features: properties of the ground in each voxel of the label lattice (paper, IV-C, Eq. 4–5).

**Conventions.** Rows are sorted by key, on a lattice of `VOXEL_M`. Vertices lie where the surface crosses the lines
between voxel centres (see `stone/surface/screened_poisson.py`), never on voxel borders.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.geometry.corners import corners_of
from stone.geometry.lattice import Keys, find, indices_of, keys_of, pack, table_of
from stone_base.label_grid import MAP_VOXEL_M

VOXEL_M = MAP_VOXEL_M


@dataclass(frozen=True, eq=False)
class VoxelFeatures:
    """`keys` (K,) sorted; `features` (K, 3) float64: mean elevation m, slope rad, roughness log m² of `vertices` (K,)
    vertices.
    """

    keys: Keys
    features: NDArray[np.float64]
    vertices: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.keys)

    def where(self, keep: NDArray[np.bool_]) -> "VoxelFeatures":
        return VoxelFeatures(self.keys[keep], np.compress(keep, self.features, axis=0), self.vertices[keep])


def voxel_features(vertices_map: NDArray[np.float64], features: NDArray[np.float64]) -> VoxelFeatures:
    """Return F_k, the mean of the vertex features in voxel k (Eq. 4–5); `vertices_map` (V, 3), `features` (V, 3)."""
    keys, inverse, counts = np.unique(keys_of(vertices_map, VOXEL_M), return_inverse=True, return_counts=True)
    sums = np.stack([np.bincount(inverse, column, len(keys)) for column in features.T], axis=1)
    return VoxelFeatures(keys, sums.reshape(-1, features.shape[1]) / counts[:, None], counts.astype(np.int64))


def looks_of(voxels: Keys, point_keys: Keys, frames_seen: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the number of frames that hit each voxel (K,): the maximum over the half-size cells inside it.

    `point_keys` (M,) are the keys of these cells, which `frames_seen` (M,) frames hit. A voxel without points has 0.
    """
    table, looks = table_of(voxels), np.zeros(len(voxels), np.int64)
    _look(indices_of(point_keys), frames_seen, (table.keys, table.rows), looks)
    return looks


@njit(cache=True, nogil=True)
def _look(indices, frames_seen, table, looks):  # type: ignore[no-untyped-def]
    for point in range(indices.shape[0]):
        i, j, k = indices[point]
        row = find(table[0], table[1], pack(i >> 1, j >> 1, k >> 1))
        if row >= 0:
            looks[row] = max(looks[row], frames_seen[point])


def height_above_local_ground(voxels: VoxelFeatures, radius_m: float) -> NDArray[np.float64]:
    """Return the elevation (K,) above the lowest surface within `radius_m` in plan, smoothed over the same window.

    Profile `local` uses it: the height above the surrounding ground matters, not the height of the hill. The floor is
    the minimum over a square window of columns, then its mean over the window.
    """
    columns = indices_of(voxels.keys)[:, :2]
    if len(columns) == 0:
        return np.zeros(0)
    origin, last = corners_of(columns)
    reach = round(radius_m / VOXEL_M)
    at = columns - origin + 2 * reach
    shape = tuple(last - origin + 4 * reach + 1)
    lowest = np.full(shape, np.inf)
    np.minimum.at(lowest, (at[:, 0], at[:, 1]), voxels.features[:, 0])
    floor = _smoothed(_window_minimum(lowest, reach), reach)
    return np.asarray(voxels.features[:, 0] - floor[at[:, 0], at[:, 1]], dtype=np.float64)


def _window_minimum(grid: NDArray[np.float64], reach: int) -> NDArray[np.float64]:
    """Return the minimum over the square of ± `reach` cells."""
    for axis in (0, 1):
        shifted = [np.roll(grid, shift, axis) for shift in range(-reach, reach + 1)]
        grid = np.minimum.reduce(shifted)
    return grid


def _smoothed(grid: NDArray[np.float64], reach: int) -> NDArray[np.float64]:
    """Return the mean over the finite cells of the square of ± `reach` cells."""
    known = np.isfinite(grid)
    total, weight = np.where(known, grid, 0.0), known.astype(np.float64)
    for axis in (0, 1):
        total = np.add.reduce([np.roll(total, shift, axis) for shift in range(-reach, reach + 1)])
        weight = np.add.reduce([np.roll(weight, shift, axis) for shift in range(-reach, reach + 1)])
    return np.divide(total, weight, out=np.full_like(total, np.inf), where=weight > 0)
