"""Samples of a frame, one per sensor, for exports and previews.

    map_from_ego(t) = map_from_ego(frame) @ track(stamp)⁻¹ @ track(t)

**Conventions.** `stamp_ns` is the sensor's measurement time on the LiDAR's clock. Between frames the robot moved along
the sequence's track, starting at the frame's own pose, so that refined frame poses refine all others too. Poses are
never extrapolated.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from stone.geometry.se3 import SE3
from stone.geometry.trajectory import Trajectory
from stone.sensors.sequence import Sequence


@dataclass(frozen=True, eq=False)
class LidarSample:
    """N returns, finite and not (0, 0, 0), moved to the frame's stamp if the cloud has times.

    `intensity` (N,) is the driver's value, 0 if it is missing or not finite; `ring` (N,) is the laser, 0 if the cloud
    has none.
    """

    points_lidar: NDArray[np.float32]
    intensity: NDArray[np.float32]
    ring: NDArray[np.uint16]


@dataclass(frozen=True, eq=False)
class CameraSample:
    """One image as a JPEG file: the recorded bytes if they are JPEG, otherwise encoded once."""

    stamp_ns: int
    content: bytes
    width_px: int
    height_px: int


@dataclass(frozen=True, eq=False)
class RadarSample:
    """N detections that the radar marks as valid, in its order.

    `points_radar` (N, 3) are in the radar's axes at `stamp_ns`; `points_lidar` (N, 3) are moved to the frame's stamp in
    the LiDAR's axes. `range_rate_m_s` (N,) was measured; `ground_rate_m_s` (N,) is compensated for the robot's motion,
    0 for static objects. `points_lidar` and `ground_rate_m_s` are NaN if the track has no pose.
    """

    stamp_ns: int
    points_radar: NDArray[np.float64]
    points_lidar: NDArray[np.float64]
    range_rate_m_s: NDArray[np.float64]
    ground_rate_m_s: NDArray[np.float64]
    rcs_db: NDArray[np.float32]


class SampleSource(Protocol):
    """The source of samples. Picklable, so that workers can open it; fast in frame order."""

    def lidar(self, index: int) -> LidarSample:
        """Return the sweep of frame `index`."""
        ...

    def camera(self, channel: str, index: int) -> CameraSample | None:
        """Return the image of this camera for frame `index`, or None."""
        ...

    def radar(self, channel: str, index: int) -> RadarSample | None:
        """Return the scan of this radar for frame `index`, or None."""
        ...


def egos_at(
    sequence: Sequence, indices: NDArray[np.int64], stamps_ns: NDArray[np.int64]
) -> tuple[SE3, NDArray[np.bool_]]:
    """Return `map_from_ego` (N,) at times (N,) near frames `indices` (N,), and which exist; the others are NaN.

    A sequence without a track moves from frame to frame.
    """
    frames = sequence.frames
    own_ns, own = frames.stamps_ns[indices], frames.map_from_ego[indices]
    track = sequence.track or Trajectory(frames.stamps_ns, frames.map_from_ego)
    begin, end = (track.at(times_ns, sequence.max_pose_gap_ns) for times_ns in (own_ns, stamps_ns))
    moved = own @ begin.map_from_ego.inverse() @ end.map_from_ego
    is_own = own_ns == stamps_ns
    is_ok = is_own | (begin.is_ok & end.is_ok & (begin.segment == end.segment))
    poses = np.where(is_own[:, None], own.wxyz_xyz, np.where(is_ok[:, None], moved.wxyz_xyz, np.nan))
    return SE3(poses), is_ok
