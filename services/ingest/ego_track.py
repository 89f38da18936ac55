"""The ego trajectory by whatever source was chosen: `ins_poses`, `poses` (odometry, TF) or `kiss_odometry`."""

from dataclasses import dataclass

from services.ingest.associating import mount_of
from services.ingest.bag import Bag
from services.ingest.extrinsics import plain, static_tree
from services.ingest.ins_poses import track_from_ins
from services.ingest.kiss_odometry import Progress, SweepTopic, track_from_sweeps
from services.ingest.levelling import ImuTopic, imu_topic, levelled
from services.ingest.lidar_clock import LidarClock
from services.ingest.messages.novatel import decode_bestpos
from services.ingest.messages.tf import decode_transforms
from services.ingest.poses import PoseTrack, Rig, track_from_odometry, track_from_tf
from services.ingest.recorded import Recorded
from services.ingest.sources import Sources
from services.ingest.track_jumps import split_at_jumps
from stone.calibration import Calibration


def recorded_rig(recorded: Recorded, sources: Sources, calibration: Calibration) -> Rig:
    """The mounts of the calibration beside those the recording publishes. Raises what decoding TF raises."""
    samples = [pair for topic in sources.tf_static for pair in decode_transforms(recorded.messages[topic])]
    return Rig(calibration, static_tree(samples), plain(recorded.frame_id(sources.lidar.name)))


@dataclass(frozen=True, eq=False)
class PoseInputs:
    """What a track is made of; the recording is open."""

    bag: Bag
    recorded: Recorded
    sources: Sources
    clock: LidarClock


def ego_track(inputs: PoseInputs, rig: Rig, progress: Progress) -> PoseTrack:
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


def _recorded_track(recorded: Recorded, sources: Sources, rig: Rig) -> PoseTrack:
    topic, messages = sources.pose.name, recorded.messages[sources.pose.name]
    if sources.pose_role == "ins":
        fixes = decode_bestpos(recorded.messages[sources.fixes.name]) if sources.fixes is not None else None
        return track_from_ins(messages, topic, rig.calibration, fixes)
    track = track_from_odometry if sources.pose_role == "odometry" else track_from_tf
    return track(messages, topic, rig)
