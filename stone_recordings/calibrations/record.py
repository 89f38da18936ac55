"""Calibrations as JSON objects, passed between processes of one code version.

**Conventions.** Floats survive exactly: JSON writes the shortest digits that read back the same.
"""

from dataclasses import asdict
from typing import Any

import numpy as np

from stone.geometry.se3 import SE3
from stone.sensors.calibration import Box, Calibration, CameraIntrinsics, Footprint, Mount, Vehicle


def calibration_record(calibration: Calibration) -> dict[str, Any]:
    """Return a JSON object; poses are seven numbers, wxyz then xyz."""
    return {
        "name": calibration.name,
        "ego_from_lidar": calibration.ego_from_lidar.wxyz_xyz.tolist(),
        "mounts": [_mount_record(mount) for mount in calibration.mounts],
        "footprint": asdict(calibration.footprint),
        "self_boxes_ego": [asdict(box) for box in calibration.self_boxes_ego],
        "vehicle": asdict(calibration.vehicle),
    }


def calibration_of(record: dict[str, Any]) -> Calibration:
    """Return the calibration from `calibration_record`. Raises `KeyError`, `TypeError`, `ValueError`, `ShapeError`."""
    return Calibration(
        name=record["name"],
        ego_from_lidar=SE3(np.array(record["ego_from_lidar"])),
        mounts=tuple(_mount(mount) for mount in record["mounts"]),
        footprint=Footprint(**record["footprint"]),
        self_boxes_ego=tuple(Box(tuple(box["min_m"]), tuple(box["max_m"])) for box in record["self_boxes_ego"]),
        vehicle=Vehicle(**record.get("vehicle", {})),  # label sets of earlier versions have none
    )


def _mount_record(mount: Mount) -> dict[str, Any]:
    return {
        "name": mount.name,
        "kind": mount.kind,
        "lidar_from_sensor": mount.lidar_from_sensor.wxyz_xyz.tolist(),
        "frame_id": mount.frame_id,
        "time_offset_ns": mount.time_offset_ns,
        "intrinsics": asdict(mount.intrinsics) if mount.intrinsics else None,
    }


def _mount(record: dict[str, Any]) -> Mount:
    intrinsics = record["intrinsics"]
    if intrinsics is not None:
        intrinsics = CameraIntrinsics(**{**intrinsics, "distortion": tuple(intrinsics["distortion"])})
    pose = SE3(np.array(record["lidar_from_sensor"]))
    return Mount(**{**record, "lidar_from_sensor": pose, "intrinsics": intrinsics})
