"""A sweep as if it had been measured in one instant: every point moved to where the LiDAR was at the stamp.

    lidar(stamp)_from_lidar(t) = (map_from_ego(stamp) @ ego_from_lidar)⁻¹ @ map_from_ego(t) @ ego_from_lidar

**Conventions.** `offset_ns` is a point's time relative to the sweep's stamp. One transform serves each 100 µs bin,
centred on whole multiples of 100 µs, so a pose is at most 50 µs off: below 1.3 mm at 40 m, 4.8 m/s and 28 °/s.

A point whose bin has no pose (before the first, after the last, in a gap, beyond a jump) is dropped, not moved by the
nearest pose: clamping is extrapolation with velocity zero and smears what it keeps. A frame whose whole sweep is not
covered should be excluded before it comes here (`services.ingest` does so with a reason); the drop is for stragglers.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.errors import ShapeError, StoneError
from stone.se3 import SE3
from stone.trajectory import DEFAULT_MAX_GAP_NS, Trajectory

BIN_NS = 100_000

# No LiDAR turns slower than 1 Hz; offsets beyond this are absolute times or garbage, and would size the pose table.
MAX_OFFSET_NS = 1_000_000_000


class PointOffsetError(StoneError):
    """Point times lie implausibly far from the stamp of their sweep."""

    code = "point_offset"

    def __init__(self, first_ns: int, last_ns: int) -> None:
        super().__init__(
            f"point times reach from {first_ns} ns to {last_ns} ns around the sweep's stamp; the limit is "
            f"±{MAX_OFFSET_NS} ns (absolute times taken for relative ones?)"
        )


@dataclass(frozen=True, eq=False)
class SweepMotion:
    """`stamp_from_bin` of B bins from `first_bin`: rotation (B, 3, 3), translation (B, 3), metres, `has_pose` (B,)."""

    first_bin: int
    rotation: NDArray[np.float32]
    translation_m: NDArray[np.float32]
    has_pose: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class SweepMount:
    """What turns time into a LiDAR pose: the ego trajectory, the mount, and the longest gap that is bridged."""

    trajectory: Trajectory
    ego_from_lidar: SE3
    max_gap_ns: int = DEFAULT_MAX_GAP_NS


def sweep_motion(mount: SweepMount, stamp_ns: int, span_ns: tuple[int, int]) -> SweepMotion:
    """The transforms of all bins that hold offsets in `span_ns` = (first, last), both included.

    No bin has a pose when the stamp itself has none. Raises PointOffsetError beyond ±1 s.
    """
    if not -MAX_OFFSET_NS <= span_ns[0] <= span_ns[1] <= MAX_OFFSET_NS:
        raise PointOffsetError(*span_ns)
    first_bin, last_bin = _bin_of(span_ns[0]), _bin_of(span_ns[1])
    times_ns = stamp_ns + np.arange(first_bin, last_bin + 1, dtype=np.int64) * BIN_NS
    found = mount.trajectory.at(np.concatenate([np.array([stamp_ns], np.int64), times_ns]), mount.max_gap_ns)
    map_from_lidar = found.map_from_ego @ mount.ego_from_lidar
    stamp_from_bin = map_from_lidar[0].inverse() @ map_from_lidar[1:]
    return SweepMotion(
        first_bin,
        stamp_from_bin.rotation().astype(np.float32),
        stamp_from_bin.translation_m.astype(np.float32),
        (found.is_ok & (found.segment == found.segment[0]))[1:] & found.is_ok[0],
    )


def deskew(
    points_lidar: NDArray[np.float32], offset_ns: NDArray[np.int64], mount: SweepMount, stamp_ns: int
) -> NDArray[np.float32]:
    """Points (N, 3) moved to the sweep's stamp, in their order, without those (≤ N) whose time has no pose.

    Raises ShapeError when points and offsets do not pair up, PointOffsetError when an offset is beyond ±1 s.
    """
    if points_lidar.ndim != 2 or points_lidar.shape[1] != 3:
        raise ShapeError("points_lidar", points_lidar.shape, "(N, 3)")
    if offset_ns.shape != points_lidar.shape[:1]:
        raise ShapeError("offset_ns", offset_ns.shape, f"({points_lidar.shape[0]},), one per point")
    if not len(points_lidar):
        return points_lidar.copy()
    motion = sweep_motion(mount, stamp_ns, (int(offset_ns.min()), int(offset_ns.max())))
    moved, kept = _moved(
        points_lidar, offset_ns, motion.first_bin, motion.rotation, motion.translation_m, motion.has_pose
    )
    return np.asarray(moved[:kept], dtype=np.float32)


def _bin_of(offset_ns: int) -> int:
    return (offset_ns + BIN_NS // 2) // BIN_NS


@njit(cache=True, nogil=True)
def _moved(points, offset_ns, first_bin, rotation, translation, has_pose):  # type: ignore[no-untyped-def]
    moved = np.empty_like(points)
    kept = 0
    for i in range(points.shape[0]):
        b = (offset_ns[i] + BIN_NS // 2) // BIN_NS - first_bin
        if not has_pose[b]:
            continue
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        for row in range(3):
            moved[kept, row] = (
                rotation[b, row, 0] * x + rotation[b, row, 1] * y + rotation[b, row, 2] * z + translation[b, row]
            )
        kept += 1
    return moved, kept
