"""Radar detections moved to the frame's stamp, and the speed of objects over the ground.

    stamp_from_radar = map_from_lidar(stamp)⁻¹ @ map_from_lidar(t) @ lidar_from_radar
    ground_rate = range_rate + v_radar · p / |p|

**Conventions.** t is the radar's measurement time. Static objects are moved to their position as seen at the stamp.
Moving objects have moved by their own speed, which a radar measures only along its ray. A range rate is positive for
growing range; over the ground it is 0 for static objects. `v_radar` is the sensor's velocity in its own axes, including
lever arm and turning. Source: Kellner et al., "Instantaneous ego-motion estimation using Doppler radar", ITSC 2013.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone.geometry.se3 import SE3, rotate
from stone.sensors.deskew import SweepMount

# Half the time span of the sensor's velocity: RTK noise of 1 cm then gives 0.07 m/s.
HALF_SPAN_NS = 100_000_000


@dataclass(frozen=True, eq=False)
class RadarMotion:
    """`stamp_from_radar`: from the radar at its measurement to the LiDAR at the stamp; `velocity_m_s` (3,) is the
    radar's.

    Both are NaN if a pose is missing.
    """

    stamp_from_radar: SE3
    velocity_m_s: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CompensatedRadar:
    """N detections: `points_lidar` (N, 3) at the stamp, `ground_rate_m_s` (N,) over the ground."""

    points_lidar: NDArray[np.float64]
    ground_rate_m_s: NDArray[np.float64]


def radar_motion(mount: SweepMount, lidar_from_radar: SE3, stamp_ns: int, taken_ns: int) -> RadarMotion:
    """Return a radar's motion from its measurement (`taken_ns`) to the frame's stamp, and its velocity."""
    times_ns = np.array([stamp_ns, taken_ns, taken_ns - HALF_SPAN_NS, taken_ns + HALF_SPAN_NS], np.int64)
    poses = mount.trajectory.at(times_ns, mount.max_gap_ns)
    map_from_lidar = poses.map_from_ego @ mount.ego_from_lidar
    map_from_radar = map_from_lidar[1:] @ lidar_from_radar
    # A pose beyond a jump of the track is no neighbour.
    is_ok = poses.is_ok & (poses.segment == poses.segment[0])
    stamp_from_radar = map_from_lidar[0].inverse() @ map_from_radar[0]
    if not is_ok[:2].all():
        return RadarMotion(SE3(np.full(7, np.nan)), np.full(3, np.nan))
    return RadarMotion(stamp_from_radar, _velocity(map_from_radar, times_ns[1:], is_ok[1:]))


def compensated(
    points_radar: NDArray[np.float64], range_rate_m_s: NDArray[np.float64], motion: RadarMotion
) -> CompensatedRadar:
    """Return the compensated points (N, 3) and range rates (N,); a point at the radar's origin has no rate (NaN)."""
    distance_m = np.linalg.norm(points_radar, axis=1)
    towards = points_radar / np.where(distance_m > 0, distance_m, np.nan)[:, None]
    return CompensatedRadar(motion.stamp_from_radar @ points_radar, range_rate_m_s + towards @ motion.velocity_m_s)


def _velocity(map_from_radar: SE3, times_ns: NDArray[np.int64], is_ok: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the velocity from the widest available difference of [at, before, after]; NaN if only the first exists."""
    if not is_ok[1:].any():
        return np.full(3, np.nan)
    first, last = (1 if is_ok[1] else 0), (2 if is_ok[2] else 0)
    place_m = map_from_radar.translation_m
    velocity_map = (place_m[last] - place_m[first]) / (int(times_ns[last] - times_ns[first]) * 1e-9)
    return rotate(map_from_radar.inverse().wxyz[0], velocity_map)
