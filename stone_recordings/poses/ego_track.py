"""The ego trajectory by whatever source was chosen: `ins_poses`, `poses` (odometry, TF) or `kiss_odometry`."""

from dataclasses import dataclass

from stone.sensors.calibration import Calibration
from stone_recordings.bags.bag import Bag
from stone_recordings.clocks.lidar_clock import LidarClock
from stone_recordings.messages.novatel import decode_bestpos
from stone_recordings.messages.tf import decode_transforms
from stone_recordings.poses.extrinsics import plain, static_tree
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
    """The mounts of the calibration beside those the recording publishes. Raises what decoding TF raises."""
    samples = [pair for topic in sources.tf_static for pair in decode_transforms(recorded.messages[topic])]
    return RigMounts(calibration, static_tree(samples), plain(recorded.frame_id(sources.lidar.name)), clocks)


@dataclass(frozen=True, eq=False)
class PoseInputs:
    """What a track is made of; the recording is open."""

    bag: Bag
    recorded: RecordedTopics
    sources: Sources
    clock: LidarClock


def ego_track(inputs: PoseInputs, rig: RigMounts, progress: Progress) -> PoseTrack:
    """The track, split where it jumps; `progress` is told where finding it takes long.

    Raises as `track_from_ins`, `track_from_odometry`, `track_from_tf` and `track_from_sweeps` do.
    """
    if inputs.sources.pose_role == "lidar":
        track = track_from_sweeps(SweepTopic(inputs.bag, inputs.clock), rig.calibration, progress)
        return split_at_jumps(levelled(track, _calibrated_imu(inputs, rig.calibration)))
    return split_at_jumps(_recorded_track(inputs.recorded, inputs.sources, rig))


def _calibrated_imu(inputs: PoseInputs, calibration: Calibration) -> ImuTopic | None:
    """The first IMU that the calibration places; None without."""
    for topic, role in inputs.sources.associated:
        mount = mount_of(topic.name, inputs.recorded.frame_id(topic.name), role, calibration)
        if role == "imu" and mount is not None:
            return imu_topic(inputs.bag, topic.name, mount, calibration.ego_from_lidar)
    return None


def _recorded_track(recorded: RecordedTopics, sources: Sources, rig: RigMounts) -> PoseTrack:
    topic, messages = sources.pose.name, recorded.messages[sources.pose.name]
    if sources.pose_role == "ins":
        fixes = decode_bestpos(recorded.messages[sources.fixes.name]) if sources.fixes is not None else None
        return track_from_ins(messages, topic, rig.calibration, fixes)
    track = track_from_odometry if sources.pose_role == "odometry" else track_from_tf
    return track(messages, topic, rig)
