"""Turns a track of LiDAR odometry so that up is against gravity, where the recording has an IMU.

    up ∝ mean(map_from_imu(t) · force(t)) − mean acceleration of the robot in the map

**Conventions.** An accelerometer at rest measures 1 g upwards. The mean over the run takes out bumps; the track's own
speeds at its two ends tell the mean acceleration. The turn is the smallest that brings up to z, so the heading stays.
Messages are decoded in batches: memory does not grow with the recording. Source: REP 145.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from stone.findings import Finding
from stone.geometry.se3 import SE3, rotate, shortest_turn_to_z
from stone.geometry.trajectory import Trajectory
from stone.sensors.calibration import Mount
from stone_recordings.bags.bag import Bag
from stone_recordings.messages.imu import ImuSamples, decode_imu
from stone_recordings.poses.sources import PoseTrack

GRAVITY_M_S2, TRUSTED_M_S2 = 9.81, 0.5
BATCH, LEAST_SAMPLES = 2000, 100
# Over which the speed at an end of the track is taken.
END_NS = 500_000_000


@dataclass(frozen=True, eq=False)
class ImuTopic:
    """An IMU of an open recording, and where it sits."""

    bag: Bag
    name: str
    ego_from_imu: SE3
    time_offset_ns: int


def imu_topic(bag: Bag, name: str, mount: Mount, ego_from_lidar: SE3) -> ImuTopic:
    """Of a calibrated IMU."""
    return ImuTopic(bag, name, ego_from_lidar @ mount.lidar_from_sensor, mount.time_offset_ns)


def levelled(track: PoseTrack, imu: ImuTopic | None) -> PoseTrack:
    """The track with z up, or as it is where nothing tells where up is; a finding says which.

    Raises what reading and decoding the IMU raise.
    """
    up = _up(track.trajectory, imu) if imu is not None else np.full(3, np.nan)
    if not np.isfinite(up).all():
        sentence = (
            "the map's up is the robot's own at its first pose: begun on a slope, level ground is labelled as sloping"
        )
        return _said(track, Finding("SYN-506", "warning", track.topic, sentence))
    turn = shortest_turn_to_z(up)
    angle_deg = float(np.rad2deg(2 * np.arctan2(np.linalg.norm(turn[1:]), turn[0])))
    level = SE3.from_parts(turn, np.zeros(3)) @ track.trajectory.map_from_ego
    name = imu.name if imu is not None else ""
    sentence = f"the map was turned by {angle_deg:.2f}° so that up is against the gravity that {name} measured"
    turned = replace(track, trajectory=replace(track.trajectory, map_from_ego=level))
    return _said(turned, Finding("SYN-506", "info", track.topic, sentence))


def _said(track: PoseTrack, finding: Finding) -> PoseTrack:
    return replace(track, findings=(*track.findings, finding))


def _up(trajectory: Trajectory, imu: ImuTopic) -> NDArray[np.float64]:
    """Unit vector in the map (3,); NaN where too few samples fall on the track, or what they measure is no gravity."""
    total, count = np.zeros(3), 0
    acceleration_m_s2, (begin_ns, end_ns) = _gained(trajectory)
    for samples in _batches(imu):
        stamps_ns = samples.stamps_ns + imu.time_offset_ns
        found = trajectory.at(stamps_ns)
        is_used = found.is_ok & (begin_ns <= stamps_ns) & (stamps_ns <= end_ns)
        is_used &= np.isfinite(samples.linear_acceleration_m_s2).all(axis=1)
        map_from_imu = found.map_from_ego[is_used] @ imu.ego_from_imu
        total += rotate(map_from_imu.wxyz, samples.linear_acceleration_m_s2[is_used]).sum(axis=0)
        count += int(is_used.sum())
    if count < LEAST_SAMPLES:
        return np.full(3, np.nan)
    gravity = total / count - acceleration_m_s2
    size = float(np.linalg.norm(gravity))
    return gravity / size if abs(size - GRAVITY_M_S2) <= TRUSTED_M_S2 else np.full(3, np.nan)


def _batches(imu: ImuTopic) -> Iterator[ImuSamples]:
    messages = imu.bag.messages(imu.name)
    while batch := list(islice(messages, BATCH)):
        yield decode_imu(batch)


def _gained(trajectory: Trajectory) -> tuple[NDArray[np.float64], tuple[int, int]]:
    """Mean acceleration (3,), m/s², from the speeds at both ends, and from when to when; 0 for too short a track."""
    stamps_ns, place_m = trajectory.stamps_ns, trajectory.map_from_ego.translation_m
    first = int(np.searchsorted(stamps_ns, stamps_ns[0] + END_NS))
    last = int(np.searchsorted(stamps_ns, stamps_ns[-1] - END_NS, side="right")) - 1
    if not 0 < first <= last < len(stamps_ns) - 1:
        return np.zeros(3), (int(stamps_ns[0]), int(stamps_ns[-1]))
    before_ns, after_ns = int(stamps_ns[first] - stamps_ns[0]), int(stamps_ns[-1] - stamps_ns[last])
    gained_m_s = (place_m[-1] - place_m[last]) / (after_ns * 1e-9) - (place_m[first] - place_m[0]) / (before_ns * 1e-9)
    begin_ns, end_ns = int(stamps_ns[0]) + before_ns // 2, int(stamps_ns[-1]) - after_ns // 2
    return gained_m_s / ((end_ns - begin_ns) * 1e-9), (begin_ns, end_ns)
