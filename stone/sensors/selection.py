"""Selection of a sweep's points: those that are returns and not the robot itself, and those that can be labelled.

**Conventions.** Input in the LiDAR frame, output in the ego frame, float32. Points of the robot itself are dropped by
a minimum range *and* boxes: a box alone misses antennas, a range alone misses the tail.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.geometry.se3 import SE3
from stone.sensors.calibration import Box
from stone.sensors.reach import FARTHEST_POINT_M, is_in_reach

# So many points are turned at once; only a block with points near the robot is looked at one by one.
BLOCK = 64
# Where a point is near is told by other sums than whether it is inside: allow for the rounding of both.
SLACK_RATIO = 1e-6


@dataclass(frozen=True)
class SelectionParameters:
    """Minimum range from the LiDAR, and how far beyond the label grid points are still kept for the surface.

    A point outside the grid of its own frame may lie in that of another, but is then also seen from there, and nearer.
    """

    min_range_m: float = 1.0
    margin_m: float = 1.0


def world_points(
    points_lidar: NDArray[np.float32], ego_from_lidar: SE3, boxes_ego: tuple[Box, ...], min_range_m: float
) -> NDArray[np.float32]:
    """The points (M, 3) in the ego frame that are in reach, and neither nearer than `min_range_m` nor inside a box."""
    boxes = np.array([[box.min_m, box.max_m] for box in boxes_ego], np.float64).reshape(-1, 2, 3)
    points_ego = np.empty((len(points_lidar), 3), np.float32)
    near_m = max(min_range_m, _reach_m(boxes, ego_from_lidar)) * (1.0 + SLACK_RATIO)
    limits_m2 = (min_range_m**2, near_m**2)
    kept = _select(np.ascontiguousarray(points_lidar), ego_from_lidar.as_matrix(), boxes, limits_m2, points_ego)
    return points_ego[:kept]


def within(points: NDArray[np.float32], box: Box) -> NDArray[np.float32]:
    """The points (N, 3) inside the half-open box."""
    inside = np.empty_like(points)
    return inside[: _within(points, np.array([box.min_m, box.max_m]), inside)]


def _reach_m(boxes: NDArray[np.float64], ego_from_lidar: SE3) -> float:
    """How far from the LiDAR the boxes (B, 2, 3) in the ego frame reach; 0 without any, and no farther than points."""
    farthest = np.minimum(np.abs(boxes - ego_from_lidar.translation_m).max(axis=1), FARTHEST_POINT_M)
    return float(np.linalg.norm(farthest, axis=1).max(initial=0.0))


@njit(cache=True, nogil=True)
def _select(points, pose, boxes, limits, out):  # type: ignore[no-untyped-def]
    kept = 0
    for begin in range(0, points.shape[0], BLOCK):
        block = points[begin : begin + BLOCK]
        if _turn(block, pose, limits[1], out[kept:]):
            kept = _select_one_by_one(block, pose, boxes, limits[0], out, kept)
        else:
            kept += block.shape[0]
    return kept


@njit(cache=True, nogil=True, error_model="numpy")
def _turn(block, pose, near, out):  # type: ignore[no-untyped-def]
    """Write all points of the block in the ego frame; how many are nearer than `near` (m²), or out of reach."""
    count = 0
    m00, m01, m02, m03 = pose[0]  # read once: for all the compiler knows, `out` may be where the pose is
    m10, m11, m12, m13 = pose[1]
    m20, m21, m22, m23 = pose[2]
    for p in range(block.shape[0]):
        x, y, z = np.float64(block[p, 0]), np.float64(block[p, 1]), np.float64(block[p, 2])
        out[p, 0] = m00 * x + m01 * y + m02 * z + m03
        out[p, 1] = m10 * x + m11 * y + m12 * z + m13
        out[p, 2] = m20 * x + m21 * y + m22 * z + m23
        count += not (x * x + y * y + z * z >= near) & is_in_reach(x, y, z)
    return count


@njit(cache=True, nogil=True)
def _select_one_by_one(points, pose, boxes, min_range_m2, out, kept):  # type: ignore[no-untyped-def]
    for p in range(points.shape[0]):
        x, y, z = np.float64(points[p, 0]), np.float64(points[p, 1]), np.float64(points[p, 2])
        if not (x * x + y * y + z * z >= min_range_m2 and is_in_reach(x, y, z)):
            continue
        ex = pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]
        ey = pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]
        ez = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]
        is_self = False
        for b in range(boxes.shape[0]):
            low, high = boxes[b, 0], boxes[b, 1]
            in_plan = low[0] <= ex < high[0] and low[1] <= ey < high[1]
            is_self |= in_plan and low[2] <= ez < high[2]
        if not is_self:
            out[kept, 0], out[kept, 1], out[kept, 2] = ex, ey, ez
            kept += 1
    return kept


@njit(cache=True, nogil=True)
def _within(points, box, out):  # type: ignore[no-untyped-def]
    kept = 0
    low, high = box[0], box[1]
    for p in range(points.shape[0]):
        x, y, z = points[p, 0], points[p, 1], points[p, 2]
        if low[0] <= x < high[0] and low[1] <= y < high[1] and low[2] <= z < high[2]:
            out[kept] = points[p]
            kept += 1
    return kept
