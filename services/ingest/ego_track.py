"""The ego trajectory by whatever source was chosen; the sources themselves are in `poses` and `ins_poses`."""

from services.ingest.extrinsics import plain, static_tree
from services.ingest.ins_poses import track_from_ins
from services.ingest.messages.novatel import decode_bestpos
from services.ingest.messages.tf import decode_transforms
from services.ingest.poses import PoseTrack, Rig, track_from_odometry, track_from_tf
from services.ingest.recorded import Recorded
from services.ingest.sources import Sources
from stone.calibration import Calibration


def recorded_rig(recorded: Recorded, sources: Sources, calibration: Calibration) -> Rig:
    """The mounts of the calibration beside those the recording publishes. Raises what decoding TF raises."""
    samples = [pair for topic in sources.tf_static for pair in decode_transforms(recorded.messages[topic])]
    return Rig(calibration, static_tree(samples), plain(recorded.frame_id(sources.lidar.name)))


def ego_track(recorded: Recorded, sources: Sources, rig: Rig) -> PoseTrack:
    """Raises as `track_from_ins`, `track_from_odometry` and `track_from_tf` do."""
    topic, messages = sources.pose.name, recorded.messages[sources.pose.name]
    if sources.pose_role == "ins":
        fixes = decode_bestpos(recorded.messages[sources.fixes.name]) if sources.fixes is not None else None
        return track_from_ins(messages, topic, rig.calibration, fixes)
    track = track_from_odometry if sources.pose_role == "odometry" else track_from_tf
    return track(messages, topic, rig)
