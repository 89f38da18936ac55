"""SYN-530: an orientation that does not turn with the robot, compared with registered sweeps or a gyro.

    doubt (heading against course) → sweeps of that stretch, registered → turns compared → refused or accepted

**Conventions.** A doubt alone refuses nothing: a robot that drives sideways has different course and heading. Each
sweep is registered to the previous one, starting from the given poses and from those of a robot that faces its course.
Only a better fit counts against the poses. If most sweeps do not register, a gyro decides; without a gyro, an
orientation that never changes is rejected. Turns are angles of the whole rotation, which do not depend on the mount.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from stone.errors import Refused, StoneError
from stone.geometry.se3 import SE3, multiply
from stone.geometry.trajectory import Trajectory
from stone.sensors.calibration import Calibration
from stone.sensors.course import DOUBT_RAD, Doubt, doubt_of_still, doubts_of, unturned
from stone.sensors.selection import world_points
from stone_recordings.bags.bag import Bag, Topic
from stone_recordings.clocks.lidar_clock import LidarClock
from stone_recordings.messages.imu import TYPE as IMU
from stone_recordings.messages.imu import AttitudeSamples, decode_attitude, decode_imu
from stone_recordings.messages.odometry import POSE_PLACES
from stone_recordings.messages.pointcloud2 import lidar_points
from stone_recordings.messages.sweep_clouds import cloud_at
from stone_recordings.poses.sources import PoseTrack, RigMounts, track_from_odometry
from stone_recordings.sync.registration import Target, Trust
from stone_recordings.topics.sources import COURSE

Array = NDArray[np.float64]
APART_NS, MOST_PAIRS, FEWEST_SWEEPS, MIN_RANGE_M, SAMPLING_M = 300_000_000, 60, 4, 1.0, 0.4
TRUST = Trust(residual_m=0.15, is_place_asked=False)
BETTER_RATIO, MOST_DOUBTFUL, BATCH = 0.9, 0.25, 2000
MAX_GAP_NS = 1_100_000_000  # positions of a receiver come once a second
TOLERATED_RAD, TOLERATED_RATIO = float(np.deg2rad(8.0)), 0.3
OPPOSITE_RATIO, ASIDE_RAD, LEAST_WAY_M = 1.5, float(np.deg2rad(20.0)), 0.8
SAME_WAY_RATIO, UNTURNED_RAD = 0.7, 1e-4
DEAD_RAD_S = 1e-9


@dataclass(frozen=True)
class AttitudeInputs:
    """The open recording and its sweeps; `attitude` is the topic of the orientation if it is a separate topic."""

    bag: Bag
    clock: LidarClock
    attitude: str = ""


@dataclass(frozen=True, eq=False)
class _Motion:
    """From the first of K moments: the rotations (K, 4), and the way (K, 3) in the robot's axes at that moment."""

    stamps_ns: NDArray[np.int64]
    wxyz: Array
    way_m: Array

    @property
    def turned_rad(self) -> Array:
        return angles(self.wxyz)


def check_attitude(track: PoseTrack, inputs: AttitudeInputs, rig: RigMounts) -> None:
    """Raise `SYN-530` if the orientation of a track is not the robot's."""
    if track.topic == inputs.clock.topic:
        return
    still = doubt_of_still(track.trajectory)
    doubts = doubts_of(unturned(track.trajectory) if track.is_course else track.trajectory)
    for doubt in doubts or ([still] if still is not None else []):
        motions = _told(track.trajectory, inputs, doubt, rig.calibration)
        fault = _fault(track, motions, doubt, rig.calibration) if motions else _fault_by_gyro(track, inputs, doubt)
        if fault:
            raise Refused("SYN-530", f"{track.source}: {fault}; {'; or '.join(_ways(track, inputs, rig, motions))}")


def angles(wxyz: Array) -> Array:
    """Return the angle of each rotation (N,), in [0, π]."""
    return np.asarray(2 * np.arctan2(np.linalg.norm(wxyz[..., 1:], axis=-1), np.abs(wxyz[..., 0])))


def _told(
    trajectory: Trajectory, inputs: AttitudeInputs, doubt: Doubt, calibration: Calibration
) -> tuple[_Motion, _Motion] | None:
    """Return the motion by the track and by the registered sweeps; None if the sweeps do not register."""
    clock = inputs.clock
    rows = _spaced(clock, doubt)
    middle_ns = clock.ordered.stamps_ns[rows] + sum(clock.span_ns) // 2
    interpolated = trajectory.at(middle_ns, MAX_GAP_NS)
    is_told = interpolated.is_ok & (
        interpolated.segment
        == (np.median(interpolated.segment[interpolated.is_ok]) if interpolated.is_ok.any() else -1)
    )
    if int(is_told.sum()) < FEWEST_SWEEPS:
        return None
    poses, stamps_ns = interpolated.map_from_ego[is_told], middle_ns[is_told]
    seen = _registered(inputs, rows[is_told], poses, calibration)
    if seen is None:
        return None
    return _motion(stamps_ns, poses), _motion(stamps_ns, seen)


def _spaced(clock: LidarClock, doubt: Doubt) -> NDArray[np.int64]:
    """Return the rows of sweeps of a stretch, about `APART_NS` apart."""
    stamps_ns = clock.ordered.stamps_ns
    inside = np.flatnonzero((stamps_ns >= doubt.begin_ns) & (stamps_ns <= doubt.end_ns) & (clock.points > 0))
    if not len(inside):
        return inside
    apart_ns = max(APART_NS, (doubt.end_ns - doubt.begin_ns) // MOST_PAIRS)
    return inside[np.unique((stamps_ns[inside] - stamps_ns[inside[0]]) // apart_ns, return_index=True)[1]]


def _registered(inputs: AttitudeInputs, rows: NDArray[np.int64], poses: SE3, calibration: Calibration) -> SE3 | None:
    """Return each sweep's pose (K,) relative to the previous one; None if a quarter of them do not register."""
    as_driven = _as_driven(poses)
    before, at, placed, doubtful = _points(inputs, int(rows[0]), calibration), SE3.identity(), [SE3.identity()], 0
    for row in range(1, len(rows)):
        points = _points(inputs, int(rows[row]), calibration)
        guess = poses[row - 1].inverse() @ poses[row]
        target = Target(before, SAMPLING_M)
        first, second = (target.register(points, pose, TRUST) for pose in (guess, as_driven[row - 1]))
        best = second if not second.doubt and second.residual_m < BETTER_RATIO * first.residual_m else first
        best = second if first.doubt and not second.doubt else best
        doubtful += bool(best.doubt)
        at = at @ (guess if best.doubt else best.target_from_source)
        placed.append(at)
        before = points
    if doubtful > MOST_DOUBTFUL * (len(rows) - 1):
        return None
    return SE3(np.stack([pose.wxyz_xyz for pose in placed]))


def _as_driven(poses: SE3) -> SE3:
    """Return the steps (K − 1,) of a robot that faces its course."""
    way = np.diff(poses.translation_m, axis=0)
    course = np.unwrap(np.arctan2(way[:, 1], way[:, 0]))
    turn = np.gradient(course) if len(course) > 1 else np.zeros(len(course))
    half, plan_m = turn / 2, np.hypot(way[:, 0], way[:, 1])
    wxyz = np.stack([np.cos(half), np.zeros_like(half), np.zeros_like(half), np.sin(half)], axis=-1)
    return SE3.from_parts(wxyz, np.stack([plan_m * np.cos(half), plan_m * np.sin(half), way[:, 2]], axis=-1))


def _points(inputs: AttitudeInputs, row: int, calibration: Calibration) -> Array:
    """Return the returns (N, 3) of a sweep in the ego frame; none for an unreadable sweep."""
    clock = inputs.clock
    try:
        points = lidar_points(cloud_at(inputs.bag, clock.topic, int(clock.ordered.index[row]))).points_lidar
    except StoneError:
        return np.zeros((0, 3))
    return world_points(points, calibration.ego_from_lidar, calibration.self_boxes_ego, MIN_RANGE_M).astype(np.float64)


def _motion(stamps_ns: NDArray[np.int64], poses: SE3) -> _Motion:
    since = poses[0].inverse() @ poses
    return _Motion(stamps_ns, since.wxyz, since.translation_m)


def _fault(track: PoseTrack, motions: tuple[_Motion, _Motion], doubt: Doubt, calibration: Calibration) -> str:
    """Return the fault of the orientation; "" if it turns with the sweeps."""
    by_track, by_sweeps = motions
    turned, seen = by_track.turned_rad, by_sweeps.turned_rad
    apart = angles(multiply(by_track.wxyz * np.array([1.0, -1.0, -1.0, -1.0]), by_sweeps.wxyz))
    at = int(np.argmax(np.abs(seen - turned)))
    course = f"the course by {np.rad2deg(abs(doubt.course_rad)):.0f}°"
    words = _words(by_track.stamps_ns[at] - by_track.stamps_ns[0], turned[at], f"{_deg(seen[at])} and {course}")
    tolerated = max(TOLERATED_RAD, TOLERATED_RATIO * float(max(seen[at], turned[at])))
    is_course = abs(abs(doubt.course_rad) - seen[at]) <= tolerated
    if seen[at] - turned[at] > tolerated or (turned[at] - seen[at] > tolerated and is_course):
        return f"{words}: this is not the robot's attitude"
    is_placed = bool(calibration.ego_from_lidar.translation_m.any())
    most = int(np.argmax(np.minimum(seen, turned)))
    if min(seen[most], turned[most]) > TOLERATED_RAD and apart[most] > OPPOSITE_RATIO * max(seen[most], turned[most]):
        return f"its orientation turns by {_deg(turned[most])} in the opposite direction of the registered sweeps"
    if doubt.is_aside and not _is_way_seen(motions) and _never_turns(track):
        off = _deg(abs(doubt.course_rad))
        return (
            f"its orientation never changes, and the track runs {off} off it: these are positions without an attitude"
        )
    if not is_placed or np.linalg.norm(by_track.way_m[-1]) < LEAST_WAY_M or not _is_way_seen(motions):
        return ""
    x, y = (motion.way_m[-1, :2] for motion in motions)
    aside = abs(float(np.arctan2(x[0] * y[1] - x[1] * y[0], x @ y)))
    if aside <= ASIDE_RAD:
        return ""
    return f"its orientation points {_deg(aside)} off the heading that the registered sweeps show"


def _words(elapsed_ns: int, turned_rad: float, evidence: str) -> str:
    return (
        f"its orientation changes by {_deg(turned_rad)} in {elapsed_ns / 1e9:.1f} s, while the registered sweeps "
        f"turn by {evidence}"
    )


def _deg(angle_rad: float) -> str:
    return f"{np.rad2deg(angle_rad):.0f}°"


def _fault_by_gyro(track: PoseTrack, inputs: AttitudeInputs, doubt: Doubt) -> str:
    """Return the fault found by a gyro; without a gyro, an orientation that never changes is a fault if the track
    turns.
    """
    ends = track.trajectory.at(np.array([doubt.begin_ns, doubt.end_ns], np.int64), MAX_GAP_NS).map_from_ego
    turned = float(angles((ends[0].inverse() @ ends[1]).wxyz))
    course = _deg(abs(doubt.course_rad))
    for topic in _of_type(inputs.bag, (IMU,)):
        seen = _turned_by_gyro(inputs.bag, topic, doubt)
        if seen is None:
            continue
        words = f"its orientation changes by {_deg(turned)}, while the gyro of {topic.name} turns by {_deg(seen)}"
        is_off = abs(seen - turned) > max(TOLERATED_RAD, TOLERATED_RATIO * max(seen, turned))
        return f"{words} and the course by {course}: this is not the robot's attitude" if is_off else ""
    if abs(doubt.course_rad) < DOUBT_RAD or not _never_turns(track):
        return ""
    does = "leads aside of it" if doubt.is_aside else "turns"
    return (
        f"its orientation never changes, while the course {does} by {course}: these are positions without an attitude"
    )


def _never_turns(track: PoseTrack) -> bool:
    """Return whether all orientations of a track are equal to the last digit, which no filter produces."""
    wxyz = track.trajectory.map_from_ego.wxyz
    return bool(angles(multiply(wxyz[0] * np.array([1.0, -1.0, -1.0, -1.0]), wxyz)).max() <= UNTURNED_RAD)


def _turned_by_gyro(bag: Bag, topic: Topic, doubt: Doubt) -> float | None:
    """Return the angle that a gyro measured; None if it is dead or not recorded all the time."""
    stamps, rates = list[NDArray[np.int64]](), list[Array]()
    messages = bag.messages(topic.name)
    try:
        while batch := list(islice(messages, BATCH)):
            samples = decode_imu(batch)
            is_in = (samples.stamps_ns >= doubt.begin_ns) & (samples.stamps_ns <= doubt.end_ns)
            is_in &= np.isfinite(samples.angular_velocity_rad_s).all(axis=1)
            stamps.append(samples.stamps_ns[is_in])
            rates.append(samples.angular_velocity_rad_s[is_in])
    except StoneError:
        return None
    stamps_ns, first = np.unique(np.concatenate([*stamps, np.zeros(0, np.int64)]), return_index=True)
    if len(stamps_ns) < 2 or stamps_ns[-1] - stamps_ns[0] < (doubt.end_ns - doubt.begin_ns) // 2:
        return None
    rate = np.concatenate(rates)[first]
    if np.abs(rate).max() < DEAD_RAD_S:
        return None
    total = np.array([1.0, 0.0, 0.0, 0.0])
    for turn in (rate[:-1] + rate[1:]) / 2 * (np.diff(stamps_ns) * 1e-9)[:, None]:
        half = float(np.linalg.norm(turn)) / 2
        step = np.append(np.cos(half), turn / 2 * np.sinc(half / np.pi))
        total = multiply(total, step)
    return float(angles(total))


def _of_type(bag: Bag, types: tuple[str, ...]) -> Iterator[Topic]:
    return (topic for topic in bag.topics if topic.count and topic.type in types)


def _ways(
    track: PoseTrack, inputs: AttitudeInputs, rig: RigMounts, motions: tuple[_Motion, _Motion] | None
) -> Iterator[str]:
    """Yield the remedies: topics whose orientation turns with the sweeps, the sweeps if they show the way, the
    course.
    """
    yield from _other_topics(track, inputs, rig, motions[1]) if motions is not None else ()
    if motions is None or _is_way_seen(motions):
        yield "estimate the poses from the sweeps: --odometry kiss-icp"
    is_ins = track.is_smooth
    if not (track.is_course or is_ins) and track.topic in {topic.name for topic in inputs.bag.topics}:
        yield f"if the robot always drives forward, use its course as heading: --odometry {COURSE}{track.topic}"


def _is_way_seen(motions: tuple[_Motion, _Motion]) -> bool:
    """Return whether the registered sweeps show as long a way as the track has."""
    by_track, by_sweeps = (float(np.linalg.norm(motion.way_m[-1])) for motion in motions)
    return min(by_track, by_sweeps) >= SAME_WAY_RATIO * max(by_track, by_sweeps)


def _other_topics(track: PoseTrack, inputs: AttitudeInputs, rig: RigMounts, seen: _Motion) -> Iterator[str]:
    if inputs.attitude:
        for topic in _of_type(inputs.bag, (IMU,)):
            turned = _turned_by_imu(inputs.bag, topic, seen) if topic.name != inputs.attitude else None
            if turned is not None and _is_alike(turned, seen):
                yield f"take the orientation of {topic.name} ({_deg(turned.max())}): --topic imu={topic.name}"
    as_told = replace(rig, is_course=False)
    for topic in _of_type(inputs.bag, tuple(POSE_PLACES)):
        if topic.name == track.topic and not track.is_course:
            continue
        try:
            other = track_from_odometry(inputs.bag.messages(topic.name), topic.name, as_told, topic.type).trajectory
        except StoneError:
            continue
        turned = _turned(other, seen)
        if turned is not None and _is_alike(turned, seen):
            yield f"take the poses of {topic.name} ({_deg(turned.max())}): --odometry {topic.name}"


def _turned_by_imu(bag: Bag, topic: Topic, seen: _Motion) -> Array | None:
    try:
        attitude = decode_attitude(bag.messages(topic.name))
    except StoneError:
        return None
    return _turned(_as_track(attitude), seen)


def _as_track(attitude: AttitudeSamples) -> Trajectory | None:
    stamps_ns, first = np.unique(attitude.stamps_ns[attitude.is_told], return_index=True)
    if not len(stamps_ns):
        return None
    wxyz = attitude.enu_from_imu_xyzw[attitude.is_told][first][:, [3, 0, 1, 2]]
    return Trajectory(stamps_ns, SE3.from_parts(wxyz, np.zeros((len(wxyz), 3))))


def _turned(trajectory: Trajectory | None, seen: _Motion) -> Array | None:
    """Return the turns of a source at the times of the sweeps; None if it does not cover them."""
    interpolated = trajectory.at(seen.stamps_ns, MAX_GAP_NS) if trajectory is not None else None
    if interpolated is None or not interpolated.is_ok.all():
        return None
    return _motion(seen.stamps_ns, interpolated.map_from_ego).turned_rad


def _is_alike(turned: Array, seen: _Motion) -> bool:
    return bool(np.abs(turned - seen.turned_rad).max() <= max(TOLERATED_RAD, TOLERATED_RATIO * seen.turned_rad.max()))
