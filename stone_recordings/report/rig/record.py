"""A calibration in numbers, for people and programs: sensors with their mounts and lenses, and missing parts.

**Conventions.** A JSON object. Mounts are in the ego frame, as below; lens numbers are those of the file.
"""

import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stone.errors import StoneError
from stone.geometry.se3 import SE3
from stone.sensors.calibration import Calibration, CameraIntrinsics, Mount
from stone_files.calibration_bundle import read_bundle
from stone_recordings.calibrations.assembly import LINK_FROM_OPTICAL
from stone_recordings.calibrations.draft import SAME_M_OR_RATIO
from stone_recordings.calibrations.file import DEFAULT_FOOTPRINT, CalibrationRead
from stone_recordings.calibrations.recognition import recognised
from stone_recordings.calibrations.recording_rig import is_recording

# The pose of every sensor of a calibration on the robot, for drawings and tables of a rig. In the ego frame, metres.
# The LiDAR that places all others is the first, called LIDAR if the file has no name for it. A camera is optical and
# looks along its z, every other sensor along its x. Angles are roll, pitch, yaw about fixed axes (URDF). A camera's
# angles are those of its link (REP 103: x forward, z up), so that a level camera ahead has three zeros.


LIDAR = "LIDAR"
WIDEST_DEG = 360.0


@dataclass(frozen=True, eq=False)
class PlacedSensor:
    """A mount and its pose on the robot."""

    mount: Mount
    ego_from_sensor: SE3

    @property
    def at_m(self) -> NDArray[np.float64]:
        return self.ego_from_sensor.translation_m

    @property
    def looks(self) -> NDArray[np.float64]:
        """The unit direction (3,) in which the sensor looks."""
        return self.ego_from_sensor.rotation() @ ((0.0, 0.0, 1.0) if self.mount.kind == "camera" else (1.0, 0.0, 0.0))

    @property
    def rpy_deg(self) -> tuple[float, float, float]:
        """Roll, pitch, yaw."""
        is_optical = self.mount.kind == "camera"
        body = self.ego_from_sensor @ LINK_FROM_OPTICAL.inverse() if is_optical else self.ego_from_sensor
        turn = body.rotation()
        roll, yaw = math.atan2(turn[2, 1], turn[2, 2]), math.atan2(turn[1, 0], turn[0, 0])
        return math.degrees(roll), math.degrees(-math.asin(min(1.0, max(-1.0, turn[2, 0])))), math.degrees(yaw)


def placed_sensors(calibration: Calibration) -> list[PlacedSensor]:
    """Return the LiDAR, then every other mount in the calibration's order."""
    own = next((mount for mount in calibration.of_kind("lidar") if _is_origin(mount)), None)
    lidar = own if own is not None else Mount(LIDAR, "lidar", SE3.identity())
    others = [mount for mount in calibration.mounts if mount is not own]
    return [PlacedSensor(mount, calibration.ego_from_lidar @ mount.lidar_from_sensor) for mount in (lidar, *others)]


def _is_origin(mount: Mount) -> bool:
    """Return whether it is the LiDAR itself, listed for its frame or its clock."""
    return bool(np.abs(mount.lidar_from_sensor.as_matrix() - np.eye(4)).max() < SAME_M_OR_RATIO)


def fields_of_view_deg(lens: CameraIntrinsics) -> tuple[float, float]:
    """Return the horizontal and vertical field of view, from the focal lengths alone."""
    return (_field_deg(lens, lens.width_px, lens.fx_px), _field_deg(lens, lens.height_px, lens.fy_px))


def _field_deg(lens: CameraIntrinsics, size_px: int, focal_px: float) -> float:
    half_ratio = size_px / 2 / focal_px
    half_rad = half_ratio if lens.model == "equidistant" else math.atan(half_ratio)
    return min(WIDEST_DEG, math.degrees(2 * half_rad))


def calibration_facts(read: CalibrationRead) -> dict[str, Any]:
    """Return name, format, sensors, footprint, the vehicle's limits, boxes and missing parts."""
    calibration = read.calibration
    return {
        "name": calibration.name,
        "format": read.format,
        "sensors": [_sensor(sensor) for sensor in placed_sensors(calibration)],
        "footprint": {**asdict(calibration.footprint), "is_default": not is_footprint_given(read)},
        "vehicle": {**asdict(calibration.vehicle), "is_default": calibration.vehicle.is_default},
        "self_boxes_ego": [asdict(box) for box in calibration.self_boxes_ego],
        "missing": missing(read),
    }


def is_footprint_given(read: CalibrationRead) -> bool:
    return all(finding.code != DEFAULT_FOOTPRINT for finding in read.findings)


def missing(read: CalibrationRead) -> list[str]:
    """Return the optional parts that this calibration lacks, each with its consequence."""
    calibration = read.calibration
    lines = []
    if not is_footprint_given(read):
        lines.append("footprint: the paper's is used; ground under the footprint along the track becomes class T")
    if not calibration.self_boxes_ego:
        lines.append("self_boxes_ego: points on the robot itself count as obstacles")
    return lines + _missing_sensors(calibration)


def files_found(path: Path) -> list[dict[str, Any]]:
    """Return the content of each readable file of an incomplete calibration."""
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
    lines = []
    cameras = calibration.of_kind("camera")
    if not cameras:
        lines.append("cameras: mask_camera will be empty")
    if unlensed := [mount.name for mount in cameras if mount.intrinsics is None]:
        lines.append(f"intrinsics of {', '.join(unlensed)}: they do not count for mask_camera")
    if not calibration.of_kind("ins"):
        lines.append("INS: its lever arm is required if the poses come from an INS, not for odometry")
    return lines


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
