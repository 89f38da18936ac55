"""The shape of the surface around each voxel: slope, step and clearance for a vehicle, and features with less noise.

**Conventions.** The window is a disc of `WINDOW_M` in plan, about the footprint's size, and `WINDOW_VOXELS` up and
down: higher surfaces are not part of the ground. A step is the part of a rise or drop to the next columns that the
vehicle's maximum slope does not explain. Rows follow the voxels, sorted by key.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.geometry.corners import corners_of
from stone.geometry.lattice import indices_of
from stone.labels.voxels import VOXEL_M, VoxelFeatures

WINDOW_M = 0.5
WINDOW_VOXELS = 3
REACH = int(WINDOW_M / VOXEL_M)
FEWEST = 4
LEAST_SPREAD = 1e-6  # least spread of a plane's normal equations, m⁴


@dataclass(frozen=True, eq=False)
class GroundShape:
    """The shape at K voxels.

    `slope_rad` (K,): slope of the plane through the window, 0 if it has too few voxels. `step_m` (K,): height
    difference to a neighbour, up or down. `clearance_m` (K,): height to the next surface above in the column, otherwise
    inf. `pooled` (K, 3): features averaged over the voxel and its neighbours, each vertex counted once.
    """

    slope_rad: NDArray[np.float64]
    step_m: NDArray[np.float64]
    clearance_m: NDArray[np.float64]
    pooled: NDArray[np.float64]


def ground_shape(voxels: VoxelFeatures, slope_limit_rad: float, body_m: float) -> GroundShape:
    """Return the shape around each voxel. A surface less than `body_m` above a voxel counts as the same surface."""
    count = len(voxels)
    shape = GroundShape(np.zeros(count), np.zeros(count), np.full(count, np.inf), voxels.features.copy())
    if count == 0:
        return shape
    indices = indices_of(voxels.keys)
    low, high = corners_of(indices[:, :2])
    sides = high - low + 1 + 2 * REACH
    column = (
        (indices[:, 0] - low[0] + REACH) * sides[1] + indices[:, 1] - low[1] + REACH
    )  # increases with the sorted keys
    first = np.searchsorted(column, np.arange(int(sides[0] * sides[1]) + 1))
    rows = (column, indices[:, 2].copy(), voxels.features[:, 0].copy())
    columns = (first, int(sides[1]))
    _fit(rows, columns, float(np.tan(slope_limit_rad)), (shape.slope_rad, shape.step_m))
    _pool((*rows[:2], voxels.features, voxels.vertices), columns, shape.pooled)
    _clear(rows, first, body_m, shape.clearance_m)
    return shape


@njit(cache=True, nogil=True)
def _fit(rows, columns, tangent, results):  # type: ignore[no-untyped-def]
    """Accumulate the window of each column; columns within `REACH` of a voxel's column lie inside the wider grid of
    `first`.
    """
    (column_of, level, z), (first, width), (slope_rad, step_m) = rows, columns, results
    sums = np.empty(9)
    for row in range(column_of.size):
        sums[:] = 0.0
        for di in range(-REACH, REACH + 1):
            for dj in range(-REACH, REACH + 1):
                away_m = VOXEL_M * np.sqrt(di * di + dj * dj)
                if away_m > WINDOW_M:
                    continue
                column = column_of[row] + di * width + dj
                for other in range(first[column], first[column + 1]):
                    if abs(level[other] - level[row]) > WINDOW_VOXELS:
                        continue
                    rise_m = z[other] - z[row]
                    _add(sums, di * VOXEL_M, dj * VOXEL_M, rise_m)
                    if abs(di) <= 1 and abs(dj) <= 1:
                        step_m[row] = max(step_m[row], abs(rise_m) - tangent * away_m)
        slope_rad[row] = _slope(sums)


@njit(inline="always")
def _add(sums, x, y, z):  # type: ignore[no-untyped-def]
    sums[0] += 1.0
    sums[1] += x
    sums[2] += y
    sums[3] += z
    sums[4] += x * x
    sums[5] += x * y
    sums[6] += y * y
    sums[7] += x * z
    sums[8] += y * z


@njit(cache=True, nogil=True)
def _slope(sums):  # type: ignore[no-untyped-def]
    """Return the slope of the least-squares plane, or 0 if there is none."""
    if sums[0] < FEWEST:
        return 0.0
    x, y, z, xx, xy, yy, xz, yz = sums[1:] / sums[0]
    xx, xy, yy, xz, yz = xx - x * x, xy - x * y, yy - y * y, xz - x * z, yz - y * z
    spread = xx * yy - xy * xy
    if spread < LEAST_SPREAD:
        return 0.0
    along_x, along_y = (xz * yy - yz * xy) / spread, (yz * xx - xz * xy) / spread
    return np.arctan(np.sqrt(along_x**2 + along_y**2))


@njit(cache=True, nogil=True)
def _pool(rows, columns, pooled):  # type: ignore[no-untyped-def]
    """Average over the voxel and the 26 around it; a voxel has at least one vertex, so the weight is not 0."""
    (column_of, level, features, vertices), (first, width) = rows, columns
    for row in range(column_of.size):
        weight, a, b, c = 0.0, 0.0, 0.0, 0.0
        for di in range(-1, 2):
            for dj in range(-1, 2):
                column = column_of[row] + di * width + dj
                for other in range(first[column], first[column + 1]):
                    if abs(level[other] - level[row]) <= 1:
                        weight += vertices[other]
                        a += vertices[other] * features[other, 0]
                        b += vertices[other] * features[other, 1]
                        c += vertices[other] * features[other, 2]
        pooled[row, 0], pooled[row, 1], pooled[row, 2] = a / weight, b / weight, c / weight


@njit(cache=True, nogil=True)
def _clear(rows, first, body_m, clearance_m):  # type: ignore[no-untyped-def]
    column_of, _, z = rows
    for row in range(column_of.size):
        for other in range(row + 1, first[column_of[row] + 1]):
            if z[other] - z[row] > body_m:
                clearance_m[row] = z[other] - z[row]
                break
