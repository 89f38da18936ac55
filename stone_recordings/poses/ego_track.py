"""The ego trajectory from the chosen source: `ins_poses`, `poses` (odometry, TF) or `kiss_odometry`."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from stone.errors import Refused
from stone.findings import Finding
from stone.geometry.jumps import Jumps, jumps_of, split
from stone.geometry.se3 import SE3, rotate, shortest_turn_to_z, steps_of
from stone.geometry.trajectory import Trajectory
from stone.sensors.calibration import Calibration, Mount
from stone.sensors.pose_quality import Rtk, SolutionQuality
from stone_recordings.bags.bag import Bag, Topic
from stone_recordings.bags.errors import IngestError
from stone_recordings.clocks.lidar_clock import LidarClock
from stone_recordings.messages.imu import ImuSamples, decode_imu
from stone_recordings.messages.novatel import FixSamples, decode_bestpos
from stone_recordings.messages.problems import read_readable
from stone_recordings.messages.tf import TransformSamples, decode_transforms
from stone_recordings.poses.extrinsics import plain, static_tree
from stone_recordings.poses.file_poses import PoseFile, track_from_file
from stone_recordings.poses.gnss_poses import GnssTopics, first_frame_id, track_from_gnss
from stone_recordings.poses.ins_poses import track_from_ins
from stone_recordings.poses.kiss_odometry import Progress, SweepTopic, track_from_sweeps
from stone_recordings.poses.sources import PoseTrack, RigMounts, track_from_odometry, track_from_tf
from stone_recordings.sync.association import mount_of
from stone_recordings.sync.clock_offsets import POSE, ClockOffsets
from stone_recordings.sync.errors import NoUsablePoseError
from stone_recordings.sync.recorded_messages import OrderedStamps, RecordedTopics
from stone_recordings.topics.sources import Sources

# Splits a track where its source jumps and reports it: winning or losing RTK shifts positions by decimetres. Nothing is
# interpolated across a split. The parts on both sides stay where the source put them, so a map across a split does not
# fit together.


SHOWN = 3
MOST_STRAYS = 0.1


def split_at_jumps(track: PoseTrack) -> PoseTrack:
    """Return the track without isolated poses off it, with a segment for each stretch without a jump."""
    track = without_strays(track)
    jumps = _jumps(track)
    if not len(jumps.steps):
        return track
    finding = Finding("GNS-302", "warning", track.topic, _sentence(track, jumps))
    return replace(track, trajectory=split(track.trajectory, jumps.steps), findings=(*track.findings, finding))


def without_strays(track: PoseTrack) -> PoseTrack:
    """Return the track without single poses off it whose neighbours fit together; GNS-305 reports them.

    If they are more than a tenth of all poses, it is unclear which poses are right, and all stay.
    """
    jumps = _jumps(track)
    alone = jumps.steps[:-1][np.diff(jumps.steps) == 1] + 1
    if not len(alone) or len(alone) > MOST_STRAYS * len(track.trajectory):
        return track
    is_kept = np.ones(len(track.trajectory), np.bool_)
    is_kept[alone] = False
    rest = _rows(track, is_kept)
    still = np.flatnonzero(is_kept)[_jumps(rest).steps]
    is_kept[
        [index for index in alone.tolist() if is_kept[:index].any() and np.flatnonzero(is_kept[:index])[-1] in still]
    ] = True
    if is_kept.all():
        return track
    excess_m = jumps.excess_m[np.isin(jumps.steps, np.flatnonzero(~is_kept) - 1)]
    stamp_ns = int(track.trajectory.stamps_ns[np.flatnonzero(~is_kept)[int(np.argmax(excess_m))]])
    sentence = (
        f"{int((~is_kept).sum())} single poses lie off the track of their neighbours and are left out "
        f"(worst {excess_m.max():.2f} m at {stamp_ns} ns)"
    )
    left = _rows(track, is_kept)
    return replace(left, findings=(*left.findings, Finding("GNS-305", "warning", track.topic, sentence)))


def _rows(track: PoseTrack, is_kept: NDArray[np.bool_]) -> PoseTrack:
    trajectory, solution = track.trajectory, track.solution
    return replace(
        track,
        trajectory=Trajectory(trajectory.stamps_ns[is_kept], trajectory.map_from_ego[is_kept]),
        solution=solution and SolutionQuality(solution.rtk[is_kept], solution.stdev_m[is_kept]),
    )


def _jumps(track: PoseTrack) -> Jumps:
    rtk = track.solution.rtk if track.solution is not None else None
    return jumps_of(track.trajectory, None if rtk is None else rtk[1:] != rtk[:-1])


def _sentence(track: PoseTrack, jumps: Jumps) -> str:
    worst = np.sort(np.argsort(-jumps.excess_m, kind="stable")[:SHOWN])
    shown = "; ".join(_one(track, int(jumps.steps[row]), float(jumps.excess_m[row])) for row in worst)
    count = len(jumps.steps)
    more = f" (and {count - SHOWN} smaller ones)" if count > SHOWN else ""
    return f"position jumps by {shown}{more}; the track is split there and never interpolated across"


def _one(track: PoseTrack, step: int, excess_m: float) -> str:
    stamp_ns = int(track.trajectory.stamps_ns[step + 1])
    return f"{excess_m:.2f} m at {stamp_ns} ns {_status(track.solution, step)}"


def _status(solution: SolutionQuality | None, step: int) -> str:
    if solution is None:
        return "without a known status"
    before, after = Rtk(int(solution.rtk[step])).word, Rtk(int(solution.rtk[step + 1])).word
    return f"while the status changed from {before} to {after}" if before != after else f"while the status was {after}"


# Levels a track of LiDAR odometry with the gravity of the recording's IMU. up ∝ mean(map_from_imu(t) · force(t)) − mean
# acceleration of the robot in the map. An accelerometer at rest measures 1 g upwards. The mean over the run removes
# bumps; the track's speeds at its two ends give the mean acceleration. The turn is the smallest that brings up to z, so
# the heading stays. Messages are decoded in batches: memory does not grow with the recording. Source: REP 145.


GRAVITY_M_S2, TRUSTED_M_S2 = 9.81, 0.5
BATCH, LEAST_SAMPLES = 2000, 100
# The interval over which the speed at an end of the track is taken.
END_NS = 500_000_000


@dataclass(frozen=True, eq=False)
class ImuTopic:
    """An IMU of an open recording, and its mount."""

    bag: Bag
    name: str
    ego_from_imu: SE3
    time_offset_ns: int


def imu_topic(bag: Bag, name: str, mount: Mount, ego_from_lidar: SE3) -> ImuTopic:
    """Return a calibrated IMU."""
    return ImuTopic(bag, name, ego_from_lidar @ mount.lidar_from_sensor, mount.time_offset_ns)


def levelled(track: PoseTrack, imu: ImuTopic | None) -> PoseTrack:
    """Return the track with z up, or unchanged if up is unknown; a finding reports which.

    Raises the errors of reading and decoding the IMU.
    """
    up = _up(track.trajectory, imu) if imu is not None else np.full(3, np.nan)
    if not np.isfinite(up).all():
        sentence = (
            "the map's up is the robot's own up at its first pose: if the run starts on a slope, level ground is "
            "labelled as sloping"
        )
        return _said(track, Finding("SYN-506", "warning", track.topic, sentence))
    turn = shortest_turn_to_z(up)
    angle_deg = float(np.rad2deg(2 * np.arctan2(np.linalg.norm(turn[1:]), turn[0])))
    level = SE3.from_parts(turn, np.zeros(3)) @ track.trajectory.map_from_ego
    name = imu.name if imu is not None else ""
    sentence = f"the map was turned by {angle_deg:.2f}° so that z opposes the gravity measured by {name}"
    turned = replace(track, trajectory=replace(track.trajectory, map_from_ego=level))
    return _said(turned, Finding("SYN-506", "info", track.topic, sentence))


def _said(track: PoseTrack, finding: Finding) -> PoseTrack:
    return replace(track, findings=(*track.findings, finding))


def _up(trajectory: Trajectory, imu: ImuTopic) -> NDArray[np.float64]:
    """Return up as a unit vector in the map (3,); NaN if too few samples fall on the track or they measure no
    gravity.
    """
    total, count = np.zeros(3), 0
    acceleration_m_s2, (begin_ns, end_ns) = _gained(trajectory)
    for samples in _batches(imu):
        stamps_ns = samples.stamps_ns + imu.time_offset_ns
        interpolated = trajectory.at(stamps_ns)
        is_used = interpolated.is_ok & (begin_ns <= stamps_ns) & (stamps_ns <= end_ns)
        is_used &= np.isfinite(samples.linear_acceleration_m_s2).all(axis=1)
        map_from_imu = interpolated.map_from_ego[is_used] @ imu.ego_from_imu
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
    """Return the mean acceleration (3,), m/s², from the speeds at both ends, and its interval; 0 for too short a
    track.
    """
    stamps_ns, place_m = trajectory.stamps_ns, trajectory.map_from_ego.translation_m
    first = int(np.searchsorted(stamps_ns, stamps_ns[0] + END_NS))
    last = int(np.searchsorted(stamps_ns, stamps_ns[-1] - END_NS, side="right")) - 1
    if not 0 < first <= last < len(stamps_ns) - 1:
        return np.zeros(3), (int(stamps_ns[0]), int(stamps_ns[-1]))
    before_ns, after_ns = int(stamps_ns[first] - stamps_ns[0]), int(stamps_ns[-1] - stamps_ns[last])
    gained_m_s = (place_m[-1] - place_m[last]) / (after_ns * 1e-9) - (place_m[first] - place_m[0]) / (before_ns * 1e-9)
    begin_ns, end_ns = int(stamps_ns[0]) + before_ns // 2, int(stamps_ns[-1]) - after_ns // 2
    return gained_m_s / ((end_ns - begin_ns) * 1e-9), (begin_ns, end_ns)


def recorded_rig(
    recorded: RecordedTopics, sources: Sources, calibration: Calibration, clocks: ClockOffsets
) -> RigMounts:
    """Return the mounts of the calibration and those in the recording, with findings for unreadable ones."""
    samples: list[TransformSamples] = []
    findings: list[Finding] = []
    for topic in sources.tf_static:
        try:
            pairs, unread = read_readable(topic, recorded.messages[topic], decode_transforms)
            samples += pairs
        except IngestError as error:
            unread = (Finding(error.code, "warning", topic, f"{error}; the recording's own mounts are not compared"),)
        findings += unread
    lidar_frame = plain(recorded.frame_id(sources.lidar.name))
    return RigMounts(calibration, static_tree(samples), lidar_frame, clocks, tuple(findings))


@dataclass(frozen=True, eq=False)
class PoseInputs:
    """The inputs of a track; the recording is open."""

    bag: Bag
    recorded: RecordedTopics
    sources: Sources
    clock: LidarClock
    pose_file: PoseFile | None = None


def ego_track(inputs: PoseInputs, rig: RigMounts, progress: Progress) -> PoseTrack:
    """Return the track, split at its jumps; slow steps report to `progress`.

    Raises the errors of `track_from_ins`, `track_from_odometry`, `track_from_tf`, `track_from_gnss`, `track_from_file`
    and `track_from_sweeps`.
    """
    if inputs.sources.pose_role == "lidar":
        track = track_from_sweeps(SweepTopic(inputs.bag, inputs.clock), rig.calibration, progress)
        return split_at_jumps(levelled(track, _calibrated_imu(inputs, rig.calibration)))
    if inputs.pose_file is not None:
        return split_at_jumps(track_from_file(inputs.pose_file, inputs.clock, rig))
    return split_at_jumps(_recorded_track(inputs.recorded, inputs.sources, rig))


def _calibrated_imu(inputs: PoseInputs, calibration: Calibration) -> ImuTopic | None:
    """Return the first IMU that the calibration places; None without."""
    for topic, role in inputs.sources.associated:
        mount = mount_of(topic.name, inputs.recorded.frame_id(topic.name), role, calibration)
        if role == "imu" and mount is not None:
            return imu_topic(inputs.bag, topic.name, mount, calibration.ego_from_lidar)
    return None


def _fixes(recorded: RecordedTopics, topic: Topic | None) -> tuple[FixSamples | None, tuple[Finding, ...]]:
    """Return the receiver's positions beside its solutions; None if no position can be read."""
    if topic is None:
        return None, ()
    try:
        return read_readable(topic.name, recorded.messages[topic.name], decode_bestpos)
    except IngestError as error:
        return None, (Finding(error.code, "warning", topic.name, str(error)),)


def _recorded_track(recorded: RecordedTopics, sources: Sources, rig: RigMounts) -> PoseTrack:
    topic, messages = sources.pose.name, recorded.messages[sources.pose.name]
    if sources.pose_role == "ins":
        fixes, unread = _fixes(recorded, sources.fixes)
        of_ins = track_from_ins(messages, topic, rig.calibration, fixes, rig.clocks.asked.get(POSE))
        return replace(of_ins, findings=of_ins.findings + unread)
    if sources.pose_role == "gnss":
        topics = GnssTopics(messages, topic, first_frame_id(messages, sources.pose.type))
        if (attitude := sources.attitude) is not None:
            topics = replace(topics, imu=recorded.messages[attitude.name], imu_topic=attitude.name)
        return track_from_gnss(topics, rig)
    if sources.pose_role == "tf":
        return track_from_tf(messages, topic, rig)
    return track_from_odometry(messages, topic, rig, sources.pose.type)


# The check of a track that never moves: uninitialised odometry, or a robot that stood still. Poses that all lie within
# `STILL_M` and `STILL_RAD` never moved. Odometry of a few sweeps (`stone_recordings.poses.kiss_odometry`) shows whether
# the robot did.


STILL_M, STILL_RAD = 0.01, 0.002
# Sweeps of a robot at rest drift by centimetres.
MOVED_M = 0.5
MOST_SWEEPS = 40


def motion_findings(track: PoseTrack, sweeps: SweepTopic, calibration: Calibration) -> tuple[Finding, ...]:
    """Return SYN-510 for poses that never change. Raises `SYN-510` if the sweeps move."""
    if track.topic == sweeps.clock.topic or not is_still(track.trajectory):
        return ()
    moved_m = moved_by_sweeps_m(sweeps, calibration)
    if moved_m > MOVED_M:
        raise Refused(
            "SYN-510",
            f"{track.source}: its {len(track.trajectory)} poses never change, but the sweeps show {moved_m:.1f} m "
            "of motion. Initialise the source before recording, choose another, or estimate poses from the sweeps: "
            "--odometry kiss-icp",
        )
    sentence = (
        f"its {len(track.trajectory)} poses never change, and the sweeps show no motion either: the robot stood still"
    )
    return (Finding("SYN-510", "warning", track.topic, sentence),)


def is_still(trajectory: Trajectory) -> bool:
    """Return whether all poses are equal; False for a single pose."""
    if len(trajectory) < 2:
        return False
    span_m = np.ptp(trajectory.map_from_ego.translation_m, axis=0)
    return bool(np.linalg.norm(span_m) < STILL_M and steps_of(trajectory.map_from_ego)[1].max() < STILL_RAD)


def moved_by_sweeps_m(sweeps: SweepTopic, calibration: Calibration) -> float:
    """Return the distance the robot moved in a part of the run, from its sweeps alone; 0 if they do not register."""
    try:
        track = track_from_sweeps(SweepTopic(sweeps.bag, _middle(sweeps.clock)), calibration, lambda *_: None)
    except NoUsablePoseError:
        return 0.0
    return float(np.linalg.norm(np.ptp(track.trajectory.map_from_ego.translation_m, axis=0)))


def _middle(clock: LidarClock) -> LidarClock:
    """Return the sweeps in the middle of the run."""
    begin = max(0, (len(clock.points) - MOST_SWEEPS) // 2)
    rows = slice(begin, begin + MOST_SWEEPS)
    ordered = OrderedStamps(clock.ordered.index[rows], clock.ordered.stamps_ns[rows], ())
    return replace(clock, ordered=ordered, points=clock.points[rows])
