"""The ego trajectory by whatever source was chosen: `ins_poses`, `poses` (odometry, TF) or `kiss_odometry`."""

from dataclasses import dataclass, replace

from stone.findings import Finding
from stone.sensors.calibration import Calibration
from stone_recordings.bags.bag import Bag, Topic
from stone_recordings.bags.errors import IngestError
from stone_recordings.clocks.lidar_clock import LidarClock
from stone_recordings.messages.novatel import FixSamples, decode_bestpos
from stone_recordings.messages.problems import read_readable
from stone_recordings.messages.tf import TransformSamples, decode_transforms
from stone_recordings.poses.extrinsics import plain, static_tree
from stone_recordings.poses.file_poses import PoseFile, track_from_file
from stone_recordings.poses.gnss_poses import GnssTopics, first_frame_id, track_from_gnss
from stone_recordings.poses.gravity_alignment import ImuTopic, imu_topic, levelled
from stone_recordings.poses.ins_poses import track_from_ins
from stone_recordings.poses.kiss_odometry import Progress, SweepTopic, track_from_sweeps
from stone_recordings.poses.sources import PoseTrack, RigMounts, track_from_odometry, track_from_tf
from stone_recordings.poses.track_jumps import split_at_jumps
from stone_recordings.sync.association import mount_of
from stone_recordings.sync.clock_offsets import ClockOffsets
from stone_recordings.sync.recorded_messages import RecordedTopics
from stone_recordings.topics.sources import Sources


def recorded_rig(
    recorded: RecordedTopics, sources: Sources, calibration: Calibration, clocks: ClockOffsets
) -> RigMounts:
    """The mounts of the calibration beside those the recording publishes, and what of these cannot be read."""
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
    """What a track is made of; the recording is open."""

    bag: Bag
    recorded: RecordedTopics
    sources: Sources
    clock: LidarClock
    pose_file: PoseFile | None = None


def ego_track(inputs: PoseInputs, rig: RigMounts, progress: Progress) -> PoseTrack:
    """The track, split where it jumps; `progress` is told where finding it takes long.

    Raises as `track_from_ins`, `track_from_odometry`, `track_from_tf`, `track_from_gnss`, `track_from_file` and
    `track_from_sweeps` do.
    """
    if inputs.sources.pose_role == "lidar":
        track = track_from_sweeps(SweepTopic(inputs.bag, inputs.clock), rig.calibration, progress)
        return split_at_jumps(levelled(track, _calibrated_imu(inputs, rig.calibration)))
    if inputs.pose_file is not None:
        return split_at_jumps(track_from_file(inputs.pose_file, inputs.clock, rig))
    return split_at_jumps(_recorded_track(inputs.recorded, inputs.sources, rig))


def _calibrated_imu(inputs: PoseInputs, calibration: Calibration) -> ImuTopic | None:
    """The first IMU that the calibration places; None without."""
    for topic, role in inputs.sources.associated:
        mount = mount_of(topic.name, inputs.recorded.frame_id(topic.name), role, calibration)
        if role == "imu" and mount is not None:
            return imu_topic(inputs.bag, topic.name, mount, calibration.ego_from_lidar)
    return None


def _fixes(recorded: RecordedTopics, topic: Topic | None) -> tuple[FixSamples | None, tuple[Finding, ...]]:
    """The receiver's positions beside its solutions; none where none can be read."""
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
        of_ins = track_from_ins(messages, topic, rig.calibration, fixes)
        return replace(of_ins, findings=of_ins.findings + unread)
    if sources.attitude is not None:
        turns = sources.attitude.name
        return track_from_gnss(
            GnssTopics(messages, topic, recorded.messages[turns], turns, first_frame_id(messages, sources.pose.type)),
            rig,
        )
    if sources.pose_role == "tf":
        return track_from_tf(messages, topic, rig)
    return track_from_odometry(messages, topic, rig, sources.pose.type)
