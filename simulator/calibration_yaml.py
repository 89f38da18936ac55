"""The rig's calibration in the platform's native YAML.

**Conventions.** Version 1 of `stone_calibration`: metres, quaternions wxyz, `lidar_from_sensor` for every mount.
"""

from dataclasses import asdict
from pathlib import Path

from ruamel.yaml import YAML

from stone.geometry.se3 import SE3
from stone.sensors.calibration import Calibration, Mount


def write_calibration(calibration: Calibration, path: Path) -> None:
    """Write `calibration` at `path`."""
    yaml = YAML()
    yaml.default_flow_style = None
    yaml.width = 4096
    with path.open("w", encoding="utf-8") as stream:
        yaml.dump(calibration_record(calibration), stream)


def calibration_record(calibration: Calibration) -> dict[str, object]:
    """The nested values of the file."""
    return {
        "stone_calibration": 1,
        "name": calibration.name,
        "footprint": asdict(calibration.footprint),
        "self_boxes_ego": [{"min_m": list(box.min_m), "max_m": list(box.max_m)} for box in calibration.self_boxes_ego],
        "ego_from_lidar": _transform(calibration.ego_from_lidar),
        "sensors": {mount.name: _mount(mount) for mount in calibration.mounts},
    }


def _transform(transform: SE3) -> dict[str, list[float]]:
    return {"translation_m": transform.translation_m.tolist(), "rotation_wxyz": transform.wxyz.tolist()}


def _mount(mount: Mount) -> dict[str, object]:
    record: dict[str, object] = {
        "kind": mount.kind,
        "frame_id": mount.frame_id,
        "lidar_from_sensor": _transform(mount.lidar_from_sensor),
        "time_offset_ns": mount.time_offset_ns,
    }
    if mount.intrinsics is not None:
        lens = asdict(mount.intrinsics)
        record["intrinsics"] = lens | {"distortion": list(mount.intrinsics.distortion)}
    return record
