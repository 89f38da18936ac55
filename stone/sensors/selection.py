"""Selection of a sweep's points: returns from the world, without the robot itself, that can be labelled.

**Conventions.** Input in the LiDAR frame, output in the ego frame, float32. The robot's own points are removed by a
minimum range *and* boxes: a box alone misses antennas, a range alone misses the tail.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.geometry.se3 import SE3
from stone.sensors.calibration import Box
from stone.sensors.reach import is_in_reach

AT_ONCE = 512  # points whose intermediate results stay in the cache
DROPPED, OWN, WORLD = range(3)


@dataclass(frozen=True)
class SelectionParameters:
    """Minimum range from the LiDAR, and the margin beyond the label grid within which points are kept for the surface.

    A point outside its frame's grid may lie in another frame's grid, but that frame then sees it too, from nearer.
    """

    min_range_m: float = 1.0
    margin_m: float = 1.0


@dataclass(frozen=True, eq=False)
class SelectedPoints:
    """Points (M, 3) of a sweep in the ego frame within reach: first the `worlds` points of the world in their order,
    then the robot's own.
    """

    points_ego: NDArray[np.float32]
    worlds: int

    @property
    def world_ego(self) -> NDArray[np.float32]:
        """Return the points that are neither nearer than the minimum range nor inside a box."""
        return self.points_ego[: self.worlds]


def selected(
    points_lidar: NDArray[np.float32], ego_from_lidar: SE3, boxes_ego: tuple[Box, ...], min_range_m: float
) -> SelectedPoints:
    """Return the points within reach, divided by `min_range_m` and the boxes."""
    boxes = np.array([[box.min_m, box.max_m] for box in boxes_ego], np.float64).reshape(-1, 6)
    points_ego, own = np.empty((2, len(points_lidar), 3), np.float32)
    work = (np.zeros(3 * AT_ONCE, np.float32), np.empty(3 * AT_ONCE), np.empty(AT_ONCE, np.int64))
    view = (ego_from_lidar.as_matrix(), boxes, min_range_m**2)
    worlds, owns = _select(np.ascontiguousarray(points_lidar), view, (points_ego, own), work)
    points_ego[worlds : worlds + owns] = own[:owns]
    return SelectedPoints(points_ego[: worlds + owns], worlds)


def world_points(
    points_lidar: NDArray[np.float32], ego_from_lidar: SE3, boxes_ego: tuple[Box, ...], min_range_m: float
) -> NDArray[np.float32]:
    """Return the points (M, 3) in the ego frame within reach, neither nearer than `min_range_m` nor inside a box."""
    return selected(points_lidar, ego_from_lidar, boxes_ego, min_range_m).world_ego


@njit(cache=True, nogil=True)
def _select(points, view, out, work):  # type: ignore[no-untyped-def]
    """Write the world's points and the robot's own; return their numbers."""
    pose, boxes, min_range_m2 = view
    (world, own), (apart, turned, kinds) = out, work
    worlds, owns = 0, 0
    for begin in range(0, points.shape[0], AT_ONCE):
        count = min(AT_ONCE, points.shape[0] - begin)
        _take_apart(points[begin : begin + count], apart)
        _turn(apart, pose, min_range_m2, (turned, kinds))
        for b in range(boxes.shape[0]):
            _take_out(boxes[b], turned, kinds)
        for p in range(count):
            x, y, z = turned[p], turned[AT_ONCE + p], turned[2 * AT_ONCE + p]
            if kinds[p] == WORLD:
                world[worlds, 0], world[worlds, 1], world[worlds, 2] = x, y, z
                worlds += 1
            elif kinds[p] == OWN:
                own[owns, 0], own[owns, 1], own[owns, 2] = x, y, z
                owns += 1
    return worlds, owns


@njit(cache=True, nogil=True)
def _take_apart(block, apart):  # type: ignore[no-untyped-def]
    """Copy the coordinates axis by axis, because the compiler vectorises only contiguous numbers."""
    for p in range(block.shape[0]):
        apart[p], apart[AT_ONCE + p], apart[2 * AT_ONCE + p] = block[p, 0], block[p, 1], block[p, 2]


@njit(cache=True, nogil=True, error_model="numpy")
def _turn(apart, pose, min_range_m2, out):  # type: ignore[no-untyped-def]
    """Write points in the ego frame, axis by axis, and their classification by range; rows beyond the last point are
    stale.
    """
    turned, kinds = out
    m00, m01, m02, m03 = pose[0, 0], pose[0, 1], pose[0, 2], pose[0, 3]
    m10, m11, m12, m13 = pose[1, 0], pose[1, 1], pose[1, 2], pose[1, 3]
    m20, m21, m22, m23 = pose[2, 0], pose[2, 1], pose[2, 2], pose[2, 3]
    for p in range(AT_ONCE):
        x, y, z = np.float64(apart[p]), np.float64(apart[AT_ONCE + p]), np.float64(apart[2 * AT_ONCE + p])
        turned[p] = m00 * x + m01 * y + m02 * z + m03
        turned[AT_ONCE + p] = m10 * x + m11 * y + m12 * z + m13
        turned[2 * AT_ONCE + p] = m20 * x + m21 * y + m22 * z + m23
        kind = WORLD if x * x + y * y + z * z >= min_range_m2 else OWN
        kinds[p] = kind if is_in_reach(x, y, z) else DROPPED


@njit(cache=True, nogil=True)
def _take_out(box, turned, kinds):  # type: ignore[no-untyped-def]
    """Mark points inside the half-open box as the robot's own."""
    low0, low1, low2, high0, high1, high2 = box[0], box[1], box[2], box[3], box[4], box[5]
    for p in range(AT_ONCE):
        x, y, z = turned[p], turned[AT_ONCE + p], turned[2 * AT_ONCE + p]
        is_in = (low0 <= x) & (x < high0) & (low1 <= y) & (y < high1) & (low2 <= z) & (z < high2)
        kinds[p] = min(kinds[p], OWN) if is_in else kinds[p]
