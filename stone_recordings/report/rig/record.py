"""A calibration in numbers, for people and programs: sensors with their mounts and lenses, and what is not in it.

**Conventions.** A JSON object. Mounts are in the ego frame as `stone_recordings.report.rig.places` has them; lens
numbers are those of the file.
"""

from dataclasses import asdict
from pathlib import Path
from typing import Any

from stone.errors import StoneError
from stone.sensors.calibration import Calibration
from stone_files.calibration_bundle import read_bundle
from stone_recordings.calibrations.file import DEFAULT_FOOTPRINT, CalibrationRead
from stone_recordings.calibrations.recognition import recognised
from stone_recordings.calibrations.recording_rig import is_recording
from stone_recordings.report.rig.places import PlacedSensor, fields_of_view_deg, placed_sensors


def calibration_facts(read: CalibrationRead) -> dict[str, Any]:
    """Name, format, sensors, footprint, boxes and what is missing."""
    calibration = read.calibration
    return {
        "name": calibration.name,
        "format": read.format,
        "sensors": [_sensor(sensor) for sensor in placed_sensors(calibration)],
        "footprint": {**asdict(calibration.footprint), "is_default": not is_footprint_given(read)},
        "self_boxes_ego": [asdict(box) for box in calibration.self_boxes_ego],
        "missing": missing(read),
    }


def is_footprint_given(read: CalibrationRead) -> bool:
    return all(finding.code != DEFAULT_FOOTPRINT for finding in read.findings)


def missing(read: CalibrationRead) -> list[str]:
    """What a calibration may say and this one does not, each with what that means."""
    calibration = read.calibration
    said = []
    if not is_footprint_given(read):
        said.append("footprint: the paper's is taken; T is the ground that the footprint was driven over")
    if not calibration.self_boxes_ego:
        said.append("self_boxes_ego: points on the robot itself count as obstacles")
    return said + _missing_sensors(calibration)


def files_found(path: Path) -> list[dict[str, Any]]:
    """What each file says by itself, for a calibration that is no whole one; nothing of what cannot be read at all."""
    try:
        parts = () if is_recording(path) else recognised(read_bundle(path), path.name).parts
    except StoneError:
        return []
    return [
        {
            "file": part.file,
            "format": part.format or "rig",
            "transforms": [[edge.parent, edge.child] for edge in part.edges],
            "lenses": list(part.lenses),
        }
        for part in parts
    ]


def _missing_sensors(calibration: Calibration) -> list[str]:
    said = []
    cameras = calibration.of_kind("camera")
    if not cameras:
        said.append("cameras: mask_camera will be empty")
    if unlensed := [mount.name for mount in cameras if mount.intrinsics is None]:
        said.append(f"intrinsics of {', '.join(unlensed)}: they do not count for mask_camera")
    if not calibration.of_kind("ins"):
        said.append("INS: its lever arm is needed where the poses come from an INS, not with odometry")
    return said


def _sensor(sensor: PlacedSensor) -> dict[str, Any]:
    (x, y, z), (roll, pitch, yaw) = sensor.at_m.tolist(), sensor.rpy_deg
    lens = sensor.mount.intrinsics
    fields = None if lens is None else [round(field, 2) for field in fields_of_view_deg(lens)]
    return {
        "name": sensor.mount.name,
        "kind": sensor.mount.kind,
        "frame_id": sensor.mount.frame_id,
        **{key: round(value, 4) + 0.0 for key, value in (("x_m", x), ("y_m", y), ("z_m", z))},
        **{key: round(value, 3) + 0.0 for key, value in (("roll_deg", roll), ("pitch_deg", pitch), ("yaw_deg", yaw))},
        "time_offset_ns": sensor.mount.time_offset_ns,
        "intrinsics": None if lens is None else {**asdict(lens), "field_of_view_deg": fields},
    }
