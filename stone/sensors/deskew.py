"""Deskewing: every point of a sweep is moved to the LiDAR's pose at the sweep's stamp.

    lidar(stamp)_from_lidar(t) = (map_from_ego(stamp) @ ego_from_lidar)⁻¹ @ map_from_ego(t) @ ego_from_lidar

**Conventions.** `offset_ns` is a point's time relative to the sweep's stamp. One transform serves each 100 µs bin,
centred on multiples of 100 µs. The time error is at most 50 µs: below 1.3 mm at 40 m, 4.8 m/s and 28 °/s.

A point is dropped if its bin has no pose: before the first, after the last, in a gap, beyond a jump, or moved out of
reach within one sweep. Moving it by the nearest pose would be extrapolation with zero velocity and smear points.
Callers should exclude frames whose sweep is not completely covered (`stone_recordings.sync` does, with a reason).
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.errors import Refused, ShapeError
from stone.geometry.quaternions import conjugate, product, slerped, turned, unit
from stone.geometry.se3 import SE3
from stone.geometry.trajectory import DEFAULT_MAX_GAP_NS, Trajectory
from stone.sensors.reach import is_in_reach

BIN_NS = 100_000

# No LiDAR turns slower than 1 Hz; larger offsets are absolute times or garbage and would inflate the pose table.
MAX_OFFSET_NS = 1_000_000_000


def point_offset(first_ns: int, last_ns: int) -> Refused:
    return Refused(
        "point_offset",
        f"point times range from {first_ns} ns to {last_ns} ns around the sweep's stamp; the limit is "
        f"±{MAX_OFFSET_NS} ns (absolute times read as relative?)",
    )


@dataclass(frozen=True, eq=False)
class SweepMotion:
    """`stamp_from_bin` of B bins from `first_bin`: rotation (B, 3, 3), translation (B, 3) in metres, `has_pose`
    (B,).
    """

    first_bin: int
    rotation: NDArray[np.float32]
    translation_m: NDArray[np.float32]
    has_pose: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class SweepMount:
    """The data that determine the LiDAR pose at a time: ego trajectory, mount, and longest bridged gap."""

    trajectory: Trajectory
    ego_from_lidar: SE3
    max_gap_ns: int = DEFAULT_MAX_GAP_NS


def sweep_motion(mount: SweepMount, stamp_ns: int, span_ns: tuple[int, int]) -> SweepMotion:
    """Return the transforms of all bins with offsets in `span_ns` = (first, last), both included.

    No bin has a pose if the stamp itself has none. Raises `point_offset` beyond ±1 s.
    """
    if not -MAX_OFFSET_NS <= span_ns[0] <= span_ns[1] <= MAX_OFFSET_NS:
        raise point_offset(*span_ns)
    first_bin, last_bin = _bin_of(span_ns[0]), _bin_of(span_ns[1])
    times_ns = stamp_ns + np.arange(first_bin, last_bin + 1, dtype=np.int64) * BIN_NS
    bins = last_bin - first_bin + 1
    motion = SweepMotion(
        first_bin, np.empty((bins, 3, 3), np.float32), np.empty((bins, 3), np.float32), np.zeros(bins, np.bool_)
    )
    path = mount.trajectory
    track = (path.stamps_ns, path.map_from_ego.wxyz_xyz, path.segments, mount.max_gap_ns)
    made = (motion.rotation, motion.translation_m, motion.has_pose)
    _fill_motion((stamp_ns, times_ns), track, mount.ego_from_lidar.wxyz_xyz, made)
    return motion


def deskew(
    points_lidar: NDArray[np.float32], offset_ns: NDArray[np.int64], mount: SweepMount, stamp_ns: int
) -> NDArray[np.float32]:
    """Return the points (≤ N, 3) moved to the sweep's stamp, in their order, without points whose time has no pose.

    Raises ShapeError if points and offsets do not match, `point_offset` if an offset is beyond ±1 s.
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


@njit(inline="always")
def _bin_of(offset_ns: int) -> int:
    return (offset_ns + BIN_NS // 2) // BIN_NS


@njit(cache=True, nogil=True)
def _fill_motion(times, track, ego_from_lidar, made):  # type: ignore[no-untyped-def]
    """Fill `stamp_from_bin` at each of the times (B,), without a pose across a break of the track."""
    stamp_ns, times_ns = times
    rotation, translation, has_pose = made
    (q, t), is_ok, segment = _lidar_at(stamp_ns, track, ego_from_lidar)
    if not is_ok:
        return
    back = unit(conjugate(q))
    x, y, z = turned(conjugate(q), t)
    for b in range(times_ns.shape[0]):
        (q, t), is_ok, own_segment = _lidar_at(times_ns[b], track, ego_from_lidar)
        u, v, w = turned(back, t)
        has_pose[b] = is_ok and own_segment == segment and is_in_reach(u - x, v - y, w - z)
        translation[b, 0], translation[b, 1], translation[b, 2] = u - x, v - y, w - z
        _write_rotation(unit(product(back, q)), rotation[b])


@njit(cache=True, nogil=True)
def _lidar_at(time_ns, track, ego_from_lidar):  # type: ignore[no-untyped-def]
    """Return `map_from_lidar` at a time as rotation and translation, whether it exists, and its segment
    (`Trajectory.at`).
    """
    stamps_ns, poses, segment, max_gap_ns = track
    left = max(np.searchsorted(stamps_ns, time_ns, side="right") - 1, 0)
    is_alone = stamps_ns[left] == time_ns or left + 1 == stamps_ns.shape[0]
    right = left if is_alone else left + 1
    gap_ns = stamps_ns[right] - stamps_ns[left]
    is_ok = stamps_ns[0] <= time_ns <= stamps_ns[-1] and gap_ns <= max_gap_ns and segment[left] == segment[right]
    ratio = (time_ns - stamps_ns[left]) / max(gap_ns, 1)
    a, b, mount = poses[left], poses[right], ego_from_lidar
    q = unit(slerped((a[0], a[1], a[2], a[3]), (b[0], b[1], b[2], b[3]), ratio))
    lever = turned(q, (mount[4], mount[5], mount[6]))
    x = lever[0] + ((1 - ratio) * a[4] + ratio * b[4])
    y = lever[1] + ((1 - ratio) * a[5] + ratio * b[5])
    z = lever[2] + ((1 - ratio) * a[6] + ratio * b[6])
    return (unit(product(q, (mount[0], mount[1], mount[2], mount[3]))), (x, y, z)), is_ok, segment[left]


@njit(inline="always")
def _write_rotation(q, matrix):  # type: ignore[no-untyped-def]
    w, x, y, z = q
    matrix[0, 0], matrix[0, 1], matrix[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    matrix[1, 0], matrix[1, 1], matrix[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    matrix[2, 0], matrix[2, 1], matrix[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)


@njit(cache=True, nogil=True)
def _moved(points, offset_ns, first_bin, rotation, translation, has_pose):  # type: ignore[no-untyped-def]
    """Move points in (nearly) time order: neighbours share a bin and are moved together."""
    moved = np.empty_like(points)
    kept, begin = 0, 0
    while begin < points.shape[0]:
        b = _bin_of(offset_ns[begin])
        first_ns, end = b * BIN_NS - BIN_NS // 2, begin + 1
        while end < points.shape[0] and first_ns <= offset_ns[end] < first_ns + BIN_NS:
            end += 1
        if has_pose[b - first_bin]:
            out = moved[kept : kept + end - begin]
            _move(points[begin:end], rotation[b - first_bin], translation[b - first_bin], out)
            kept += end - begin
        begin = end
    return moved, kept


@njit(cache=True, nogil=True)
def _move(points, rotation, translation, moved):  # type: ignore[no-untyped-def]
    r00, r01, r02 = rotation[0]
    r10, r11, r12 = rotation[1]
    r20, r21, r22 = rotation[2]
    t0, t1, t2 = translation
    for p in range(points.shape[0]):
        x, y, z = points[p, 0], points[p, 1], points[p, 2]
        moved[p, 0] = r00 * x + r01 * y + r02 * z + t0
        moved[p, 1] = r10 * x + r11 * y + r12 * z + t1
        moved[p, 2] = r20 * x + r21 * y + r22 * z + t2
