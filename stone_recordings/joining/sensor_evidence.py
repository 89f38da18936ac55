"""Evidence of a recording's clock from its sensors: turns of cameras and gyros, speeds of radars.

**Conventions.** A sample of each topic is read, spread over the recording, so that a long recording costs as much as a
short one. Unreadable messages are skipped. Times are by the recording's own clock, seconds from the track's first pose.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone.errors import StoneError
from stone.geometry.se3 import SE3
from stone.geometry.trajectory import Trajectory
from stone.sensors.calibration import Calibration
from stone.sensors.lag_fit import DopplerEvidence, TurnEvidence
from stone.sensors.picture_shift import Picture, brightness_of, picture_shift
from stone.sensors.sensor_motion import SensorMotion, sensor_motion
from stone_recordings.bags.bag import Bag
from stone_recordings.clocks.timing import stamp_of
from stone_recordings.messages.camera import picture_of
from stone_recordings.messages.imu import decode_imu
from stone_recordings.messages.radars.radar import decode_radar
from stone_recordings.report.inspection import frame_id_of
from stone_recordings.sync.association import mount_of
from stone_recordings.topics.profiles import Candidate

MOST_PAIRS, MOST_SCANS, MOST_GYRO_SAMPLES = 240, 1500, 400_000
MOST_DETECTIONS = 20_000
PICTURE_WIDTH_PX = 160
# Pictures nearer in time hardly differ, farther ones show other things.
LEAST_PAIR_NS, MOST_PAIR_NS = 45_000_000, 350_000_000
GYRO_STEP_S, GYRO_GAP_S, MOST_GYRO_STEPS = 0.05, 0.1, 4000
FEWEST_STEPS = 40
NEAREST_M = 0.1
LAST_RATE_RAD_S = 100.0
NO_MOUNT = SE3(np.array([1.0, 0, 0, 0, 0, 0, 0]))

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RobotMotion:
    """The motion of the robot, on the clock of the run, and the mounts of its sensors."""

    track: Trajectory
    calibration: Calibration
    max_gap_ns: int

    def of(self, ego_from_sensor: SE3) -> SensorMotion | None:
        return sensor_motion(self.track, ego_from_sensor, self.max_gap_ns)

    def seconds(self, stamps_ns: NDArray[np.int64]) -> Array:
        return np.asarray((stamps_ns - self.track.stamps_ns[0]).astype(np.float64) * 1e-9)


def camera_turns(bag: Bag, topic: Candidate, robot: RobotMotion) -> TurnEvidence | None:
    """Return the turns; None if too few pictures follow each other, or show anything. Raises the errors of
    `Bag.messages`.
    """
    motion, shifts = robot.of(NO_MOUNT), list(_shifts(bag, topic))
    if motion is None or len(shifts) < FEWEST_STEPS:
        return None
    begin, end = (robot.seconds(np.array(column, np.int64)) for column in list(zip(*shifts, strict=True))[:2])
    return TurnEvidence(motion, begin, end, np.array([shift for _, _, shift in shifts]), has_way=True)


def radar_speeds(bag: Bag, topic: Candidate, robot: RobotMotion) -> DopplerEvidence | None:
    """Return the speeds; None for a radar without a mount or without detections. Raises the errors of decoding."""
    rows = _spread(topic.count, MOST_SCANS)
    recorded = next(candidate for candidate in bag.topics if candidate.name == topic.name)
    seen = decode_radar(topic.type, (bag.message(topic.name, row) for row in rows.tolist()), recorded.schema)
    mount = mount_of(topic.name, frame_id_of(bag, recorded), "radar", robot.calibration)
    motion = robot.of(robot.calibration.ego_from_lidar @ mount.lidar_from_sensor) if mount is not None else None
    points, rates = seen.points_radar, seen.range_rate_m_s.astype(np.float64)
    distance_m = np.linalg.norm(points, axis=1)
    usable = np.flatnonzero(seen.is_valid & np.isfinite(distance_m + rates) & (distance_m > NEAREST_M))
    if motion is None or len(usable) < FEWEST_STEPS:
        return None
    usable = usable[_spread(len(usable), MOST_DETECTIONS)]
    times_s = robot.seconds(np.repeat(seen.stamps_ns, seen.counts)[usable])
    return DopplerEvidence(motion, times_s, points[usable] / distance_m[usable, None], rates[usable])


def gyro_turns(bag: Bag, topic: Candidate, robot: RobotMotion) -> TurnEvidence | None:
    """Return turns over `GYRO_STEP_S`; None for too few. Raises the errors of decoding."""
    samples = decode_imu(bag.messages(topic.name, 0, MOST_GYRO_SAMPLES))
    is_possible = (np.abs(samples.angular_velocity_rad_s) <= LAST_RATE_RAD_S).all(axis=1)
    stamps_ns, first = np.unique(samples.stamps_ns[is_possible], return_index=True)
    motion = robot.of(NO_MOUNT)
    if motion is None or len(stamps_ns) < FEWEST_STEPS:
        return None
    times_s, rates = robot.seconds(stamps_ns), samples.angular_velocity_rad_s[is_possible][first]
    steps_s = np.diff(times_s)
    turned = np.concatenate([np.zeros((1, 3)), np.cumsum((rates[1:] + rates[:-1]) / 2 * steps_s[:, None], axis=0)])
    edges = np.arange(times_s[0], times_s[-1], GYRO_STEP_S)
    angles = np.stack([np.interp(edges, times_s, axis) for axis in turned.T], axis=1)
    gaps = times_s[1:][steps_s > GYRO_GAP_S]
    is_whole = np.searchsorted(gaps, edges[1:], side="left") == np.searchsorted(gaps, edges[:-1], side="right")
    kept = np.flatnonzero(is_whole)
    kept = kept[_spread(len(kept), MOST_GYRO_STEPS)]
    if len(kept) < FEWEST_STEPS:
        return None
    return TurnEvidence(motion, edges[kept], edges[kept + 1], np.diff(angles, axis=0)[kept], has_way=False)


def stamps_of(bag: Bag, topic: Candidate) -> NDArray[np.int64]:
    """Return the header stamps in ascending order. Raises the errors of `Bag.heads`."""
    stamps = []
    for _name, _index, payload in bag.heads([topic.name]):
        try:
            stamps.append(stamp_of(payload, topic.type))
        except StoneError:
            continue
    return np.unique(np.array(stamps, np.int64))


def _shifts(bag: Bag, topic: Candidate) -> Iterator[tuple[int, int, Array]]:
    """Yield the times of two successive pictures and the shift of the second, for pairs from all over the recording."""
    stamps_ns = bag.log_times_ns(topic.name)
    following = np.searchsorted(stamps_ns, stamps_ns + LEAST_PAIR_NS)
    firsts = np.flatnonzero(following < len(stamps_ns))
    last: tuple[int, int, Picture] | None = None
    for first in firsts[_spread(len(firsts), MOST_PAIRS)].tolist():
        earlier = last if last is not None and last[0] == first else _picture(bag, topic, first)
        last = two = _picture(bag, topic, int(following[first]))
        if earlier is None or two is None or not 0 < two[1] - earlier[1] <= MOST_PAIR_NS:
            continue
        shift = picture_shift(earlier[2], two[2])
        if shift is not None:
            yield earlier[1], two[1], shift


def _picture(bag: Bag, topic: Candidate, index: int) -> tuple[int, int, Picture] | None:
    """Return index, stamp and brightness; None for an unreadable picture."""
    payload = bag.message(topic.name, index).payload
    try:
        pixels = picture_of(topic.type, payload, PICTURE_WIDTH_PX)
        return index, stamp_of(payload, topic.type), brightness_of(pixels)
    except StoneError:
        return None


def _spread(count: int, most: int) -> NDArray[np.int64]:
    """Return at most `most` of `count` indices, evenly spread."""
    return (
        np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.int64)) if count else np.zeros(0, int)
    )
