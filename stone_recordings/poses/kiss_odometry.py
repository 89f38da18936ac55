"""Poses from the sweeps alone, by KISS-ICP, for recordings without reliable poses: `--odometry kiss-icp`.

    map_from_ego(t) = ego_from_lidar @ first_from_lidar(t) @ ego_from_lidar⁻¹

**Conventions.** `map` is the ego frame at the first pose, with the robot's own up (`stone_recordings.poses.ego_track`).
A pose is the LiDAR's at the last point of a sweep, to which KISS-ICP deskews; at the stamp if points carry no time. The
first sweeps are processed twice: without a velocity to deskew the first sweep, the map would stay bent. One sweep is
held at a time and the local map drops points out of range, so memory does not grow with the recording. One thread
computes them, so that equal recordings give equal poses. Source: Vizzo et al., "KISS-ICP: In Defense of Point-to-Point
ICP", RA-L 2023; the package `kiss-icp`.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import version
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from stone.findings import Finding
from stone.geometry.se3 import SE3
from stone.geometry.trajectory import Trajectory
from stone.sensors.association import typical_period_ns
from stone.sensors.calibration import Calibration
from stone_recordings.bags.bag import Bag
from stone_recordings.clocks.lidar_clock import LidarClock
from stone_recordings.clocks.point_clock import points_at
from stone_recordings.messages.lidar import LidarPoints
from stone_recordings.poses.sources import PoseTrack
from stone_recordings.sync.errors import NoUsablePoseError

if TYPE_CHECKING:
    from kiss_icp.kiss_icp import KissICP

Progress = Callable[[str, int, int], None]
STAGE = "odometry"
# The paper's parameters for a LiDAR of this range; nearer points are on the robot itself.
MAX_RANGE_M, MIN_RANGE_M, VOXEL_M = 100.0, 1.0, 1.0
# Fewer points within range determine no pose.
LEAST_POINTS = 100
# The number of sweeps that give the robot's speed at the start of the recording.
WARM_SWEEPS = 3


@dataclass(frozen=True, eq=False)
class SweepTopic:
    """The sweeps of one topic of an open recording."""

    bag: Bag
    clock: LidarClock


@dataclass(frozen=True, eq=False)
class _Sweep:
    """The package's input: points (N, 3) and their times (N,), or none; the pose holds at `end_ns`."""

    ordinal: int
    end_ns: int
    points_lidar: NDArray[np.float64]
    times_s: NDArray[np.float64]


def track_from_sweeps(topic: SweepTopic, calibration: Calibration, progress: Progress) -> PoseTrack:
    """Return the track of all sweeps in time order. Raises NoUsablePoseError and the errors of decoding a cloud."""
    source = f"kiss-icp {version('kiss-icp')} on {topic.clock.topic} (odometry from the sweeps)"
    total = len(topic.clock.ordered.index)
    odometry = _kiss_icp()
    for sweep in islice(_sweeps(topic), WARM_SWEEPS):
        odometry.register_frame(sweep.points_lidar, sweep.times_s)
    moving, odometry = odometry.last_delta, _kiss_icp()
    odometry.last_delta = moving
    stamps_ns: list[int] = []
    start_from_lidar: list[NDArray[np.float64]] = []
    for sweep in _sweeps(topic):
        progress(STAGE, sweep.ordinal, total)
        odometry.register_frame(sweep.points_lidar, sweep.times_s)
        stamps_ns.append(sweep.end_ns)
        start_from_lidar.append(odometry.last_pose)
    progress(STAGE, total, total)
    if not stamps_ns:
        raise NoUsablePoseError(source, total, f"no sweep has {LEAST_POINTS} points within {MAX_RANGE_M:g} m")
    poses = SE3.from_matrix(np.stack(start_from_lidar))
    ego_from_lidar = calibration.ego_from_lidar
    map_from_ego = ego_from_lidar @ poses[0].inverse() @ poses @ ego_from_lidar.inverse()
    trajectory = Trajectory(np.array(stamps_ns, np.int64), map_from_ego)
    return PoseTrack(
        trajectory, source, topic.clock.topic, _passed_over(topic.clock.topic, total - len(stamps_ns), total)
    )


def _sweeps(topic: SweepTopic) -> Iterator[_Sweep]:
    """Yield the sweeps with enough points, in time order."""
    ordered = topic.clock.ordered
    for ordinal, (stamp_ns, row) in enumerate(zip(ordered.stamps_ns.tolist(), ordered.index.tolist(), strict=True)):
        points = points_at(topic.bag, topic.clock.topic, row)
        near, times_s = _timed(points, topic.clock)
        if len(near) >= LEAST_POINTS:
            yield _Sweep(ordinal, stamp_ns + topic.clock.span_ns[1], near, times_s)


def _kiss_icp() -> "KissICP":
    """Import the package on use: reading bags must not pay for its imports."""
    from kiss_icp.config import KISSConfig
    from kiss_icp.config.config import DataConfig, MappingConfig, RegistrationConfig
    from kiss_icp.kiss_icp import KissICP

    return KissICP(
        KISSConfig(
            data=DataConfig(max_range=MAX_RANGE_M, min_range=MIN_RANGE_M, deskew=True),
            mapping=MappingConfig(voxel_size=VOXEL_M),
            registration=RegistrationConfig(max_num_threads=1),
        )
    )


def _timed(points: LidarPoints, clock: LidarClock) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the returns within range (N, 3), and their times, s; no times if they carry no information.

    The package takes the spread of the times as the time between two poses, and ends the process if there is none. Two
    points in the origin, which it drops, mark a period that ends with the sweep.
    """
    distance_m = np.linalg.norm(points.points_lidar.astype(np.float64), axis=1)
    is_near = (distance_m > MIN_RANGE_M) & (distance_m < MAX_RANGE_M)
    near = points.points_lidar[is_near].astype(np.float64)
    period_ns = typical_period_ns(clock.ordered.stamps_ns)
    if points.offset_ns is None or not clock.is_timed or period_ns <= 0 or not len(near):
        return near, np.zeros(0)
    first_ns, last_ns = clock.span_ns[1] - period_ns, clock.span_ns[1]
    times_ns = np.clip(points.offset_ns[is_near], first_ns, last_ns)
    marks_ns = np.array([first_ns, last_ns])
    return np.concatenate([near, np.zeros((2, 3))]), np.concatenate([times_ns, marks_ns]) * 1e-9


def _passed_over(topic: str, count: int, total: int) -> tuple[Finding, ...]:
    if not count:
        return ()
    sentence = f"{count} of {total} sweeps have fewer than {LEAST_POINTS} points in range and gave no pose"
    return (Finding("SYN-505", "warning", topic, sentence),)
