"""The rows of nuScenes tables that do not grow with the number of data: classes, rig, log, map, scene.

**Conventions.** Keys that the schema does not have are added where it has no place for a fact; the devkit ignores them.
Rotations are quaternions wxyz, as everywhere. Source: nuScenes schema.
"""

from collections.abc import Mapping

from services.labeler.exports.nuscenes.plan import NS_PER_US, NuscenesChannel, NuscenesPlan
from services.labeler.exports.nuscenes.tables import NuscenesTableWriter, Row, token_of
from stone.sensors.calibration import CameraIntrinsics

CLASSES = (
    ("free", "a voxel without surface; mask_lidar says whether it was observed"),
    ("traversable", "the robot's footprint swept this surface"),
    ("potentially_traversable", "surface that is like the traversable one within the confidence of the reference"),
    ("non_traversable", "all other surface"),
)
VISIBILITIES = ("v0-40", "v40-60", "v60-80", "v80-100")


def add_fixed_rows(tables: Mapping[str, NuscenesTableWriter]) -> None:
    """What is the same in every export."""
    for index, (name, description) in enumerate(CLASSES):
        token = token_of("category", name)
        tables["category"].add({"token": token, "name": name, "description": description, "index": index})
    for number, level in enumerate(VISIBILITIES, 1):
        tables["visibility"].add({"token": str(number), "level": level, "description": f"visibility {level} %"})


def add_rig_rows(tables: Mapping[str, NuscenesTableWriter], plan: NuscenesPlan) -> None:
    """Sensors, their calibration, and the one log, map and scene of the sequence."""
    for channel in plan.channels:
        sensor_token = token_of("sensor", channel.name)
        tables["sensor"].add({"token": sensor_token, "channel": channel.name, "modality": channel.modality})
        tables["calibrated_sensor"].add(_calibrated_row(plan, channel, sensor_token))
    tables["log"].add(_log_row(plan))
    map_row = {
        "category": "semantic_prior",
        "token": token_of("map", plan.sequence.name),
        "filename": plan.mask_filename,
        "log_tokens": [plan.log_token],
    }
    tables["map"].add(map_row)
    tables["scene"].add(_scene_row(plan))


def pose_row(plan: NuscenesPlan, channel: NuscenesChannel, place: int) -> Row:
    """Where the robot was when a datum was measured: `global_from_ego`."""
    pose = channel.map_from_ego[place]
    x, y, z = pose.translation_m.tolist()
    return {
        "token": plan.datum_token(channel, place),
        "timestamp": int(channel.stamps_ns[place]) // NS_PER_US,
        "rotation": pose.wxyz.tolist(),
        "translation": [x - plan.low_m[0], y - plan.low_m[1], z],
    }


def _calibrated_row(plan: NuscenesPlan, channel: NuscenesChannel, sensor_token: str) -> Row:
    ego_from_sensor = plan.sequence.calibration.ego_from_lidar @ channel.mount.lidar_from_sensor
    intrinsics = channel.mount.intrinsics
    row: dict[str, object] = {
        "token": plan.calibrated_token(channel),
        "sensor_token": sensor_token,
        "translation": ego_from_sensor.translation_m.tolist(),
        "rotation": ego_from_sensor.wxyz.tolist(),
        "camera_intrinsic": [] if intrinsics is None else _matrix(intrinsics),
    }
    if intrinsics is not None:
        row |= {"camera_model": intrinsics.model, "camera_distortion": list(intrinsics.distortion)}
    return row


def _matrix(intrinsics: CameraIntrinsics) -> list[list[float]]:
    return [
        [intrinsics.fx_px, 0.0, intrinsics.cx_px],
        [0.0, intrinsics.fy_px, intrinsics.cy_px],
        [0.0, 0.0, 1.0],
    ]


def _log_row(plan: NuscenesPlan) -> Row:
    origin = plan.sequence.map_origin_deg_m
    return {
        "token": plan.log_token,
        "logfile": plan.logfile,
        "vehicle": plan.sequence.calibration.name,
        "date_captured": plan.logfile[5:15],
        "location": "unknown" if origin is None else f"{origin[0]:.4f},{origin[1]:.4f}",
        "map_origin_deg_m": origin,
        "global_from_map_m": [-plan.low_m[0], -plan.low_m[1], 0],
        "pose_source": plan.sequence.pose_source,
    }


def _scene_row(plan: NuscenesPlan) -> Row:
    frames = plan.sequence.frames
    return {
        "token": plan.scene_token,
        "log_token": plan.log_token,
        "nbr_samples": len(frames),
        "first_sample_token": frames.tokens[0],
        "last_sample_token": frames.tokens[-1],
        "name": plan.sequence.name,
        "description": f"{len(frames)} frames of {', '.join(sorted(plan.sequence.inputs))}",
    }
