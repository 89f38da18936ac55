"""The check of a track that never moves: odometry that was never set, or a robot that stood.

**Conventions.** Poses that all lie within `STILL_M` and `STILL_RAD` never moved. Whether the robot did, a few of its
sweeps tell by odometry of their own (`stone_recordings.poses.kiss_odometry`).
"""

from dataclasses import replace

import numpy as np

from stone.findings import Finding
from stone.geometry.se3 import steps_of
from stone.geometry.trajectory import Trajectory
from stone.sensors.calibration import Calibration
from stone_recordings.clocks.lidar_clock import LidarClock
from stone_recordings.poses.kiss_odometry import SweepTopic, track_from_sweeps
from stone_recordings.poses.sources import PoseTrack
from stone_recordings.sync.errors import NoUsablePoseError, StillPosesError
from stone_recordings.sync.recorded_messages import OrderedStamps

STILL_M, STILL_RAD = 0.01, 0.002
# Sweeps that stand where they stood drift by centimetres.
MOVED_M = 0.5
MOST_SWEEPS = 40


def motion_findings(track: PoseTrack, sweeps: SweepTopic, calibration: Calibration) -> tuple[Finding, ...]:
    """SYN-510 for poses that never change. Raises StillPosesError where the sweeps do."""
    if track.topic == sweeps.clock.topic or not is_still(track.trajectory):
        return ()
    moved_m = moved_by_sweeps_m(sweeps, calibration)
    if moved_m > MOVED_M:
        raise StillPosesError(track.source, len(track.trajectory), moved_m)
    sentence = (
        f"its {len(track.trajectory)} poses never change, and the sweeps show no motion either: the robot stood still"
    )
    return (Finding("SYN-510", "warning", track.topic, sentence),)


def is_still(trajectory: Trajectory) -> bool:
    """Whether all poses are one; a single pose tells nothing."""
    if len(trajectory) < 2:
        return False
    span_m = np.ptp(trajectory.map_from_ego.translation_m, axis=0)
    return bool(np.linalg.norm(span_m) < STILL_M and steps_of(trajectory.map_from_ego)[1].max() < STILL_RAD)


def moved_by_sweeps_m(sweeps: SweepTopic, calibration: Calibration) -> float:
    """How far the robot came over a part of the run, by its sweeps alone; 0 where these tell nothing."""
    try:
        track = track_from_sweeps(SweepTopic(sweeps.bag, _middle(sweeps.clock)), calibration, lambda *_: None)
    except NoUsablePoseError:
        return 0.0
    return float(np.linalg.norm(np.ptp(track.trajectory.map_from_ego.translation_m, axis=0)))


def _middle(clock: LidarClock) -> LidarClock:
    """The sweeps in the middle of the run."""
    begin = max(0, (len(clock.points) - MOST_SWEEPS) // 2)
    rows = slice(begin, begin + MOST_SWEEPS)
    ordered = OrderedStamps(clock.ordered.index[rows], clock.ordered.stamps_ns[rows], ())
    return replace(clock, ordered=ordered, points=clock.points[rows])
