"""Samples of a frame, one per sensor, as exports and previews ask for them.

    map_from_ego(t) = map_from_ego(frame) @ track(stamp)⁻¹ @ track(t)

**Conventions.** `stamp_ns` is when a sensor measured, on the LiDAR's clock. Between frames the robot moved as the
sequence's track says, from the frame's own pose, so that refined poses of frames refine all others too. Nothing is
extrapolated.
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
    """N returns, finite and not (0, 0, 0), moved to the frame's stamp where the cloud carries times.

    `intensity` (N,) is as the driver gives it, 0 where it gives none or nothing finite; `ring` (N,) is the laser, 0
    where the cloud does not say.
    """

    points_lidar: NDArray[np.float32]
    intensity: NDArray[np.float32]
    ring: NDArray[np.uint16]


@dataclass(frozen=True, eq=False)
class CameraSample:
    """One picture as a JPEG file: the recorded bytes where it was recorded so, else encoded once."""

    stamp_ns: int
    content: bytes
    width_px: int
    height_px: int


@dataclass(frozen=True, eq=False)
class RadarSample:
    """N detections that the radar itself calls valid, in its order.

    `points_radar` (N, 3) are where it saw them, in its own axes at `stamp_ns`; `points_lidar` (N, 3) the same moved to
    the frame's stamp in the LiDAR's axes. `range_rate_m_s` (N,) was measured, `ground_rate_m_s` (N,) is freed of the
    robot's motion, 0 for what stands still. `points_lidar` and `ground_rate_m_s` are NaN where the track has no pose.
    """

    stamp_ns: int
    points_radar: NDArray[np.float64]
    points_lidar: NDArray[np.float64]
    range_rate_m_s: NDArray[np.float64]
    ground_rate_m_s: NDArray[np.float64]
    rcs_db: NDArray[np.float32]


class SampleSource(Protocol):
    """Where samples come from. Picklable, so that workers can open it; in the order of frames it is cheap."""

    def lidar(self, index: int) -> LidarSample:
        """The sweep of frame `index`."""
        ...

    def camera(self, channel: str, index: int) -> CameraSample | None:
        """The picture that frame `index` takes of this camera; None where it takes none."""
        ...

    def radar(self, channel: str, index: int) -> RadarSample | None:
        """The scan that frame `index` takes of this radar; None where it takes none."""
        ...


def egos_at(
    sequence: Sequence, indices: NDArray[np.int64], stamps_ns: NDArray[np.int64]
) -> tuple[SE3, NDArray[np.bool_]]:
    """`map_from_ego` (N,) at times (N,) near frames `indices` (N,), and which of them there are; the others are NaN.

    A sequence without a track moved from frame to frame.
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
