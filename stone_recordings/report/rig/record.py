"""A calibration in numbers, for people and programs: sensors with their mounts and lenses, and what is not in it.

**Conventions.** A JSON object. Mounts are in the ego frame, as places (below) have them; lens numbers are those of the
file.
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

# Where every sensor of a calibration sits on the robot and where it looks: what drawings and tables of a rig show.
#
# **Conventions.** In the ego frame, metres. The LiDAR that all others are placed by is the first, called LIDAR where
# the file has no name for it. A camera is optical and looks along its z, everything else along its x. Angles are roll,
# pitch, yaw about fixed axes (URDF); of a camera they are those of its link (REP 103: x where it looks, z up), so that
# a level camera ahead has three zeros.


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
        """The unit direction (3,) it looks in."""
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
    """The LiDAR, then every other mount in the calibration's order."""
    own = next((mount for mount in calibration.of_kind("lidar") if _is_origin(mount)), None)
    lidar = own if own is not None else Mount(LIDAR, "lidar", SE3.identity())
    others = [mount for mount in calibration.mounts if mount is not own]
    return [PlacedSensor(mount, calibration.ego_from_lidar @ mount.lidar_from_sensor) for mount in (lidar, *others)]


def _is_origin(mount: Mount) -> bool:
    """Whether it is the LiDAR itself, listed for its frame or its clock."""
    return bool(np.abs(mount.lidar_from_sensor.as_matrix() - np.eye(4)).max() < SAME_M_OR_RATIO)


def fields_of_view_deg(lens: CameraIntrinsics) -> tuple[float, float]:
    """Across and down, by the focal lengths alone."""
    return (_field_deg(lens, lens.width_px, lens.fx_px), _field_deg(lens, lens.height_px, lens.fy_px))


def _field_deg(lens: CameraIntrinsics, size_px: int, focal_px: float) -> float:
    half_ratio = size_px / 2 / focal_px
    half_rad = half_ratio if lens.model == "equidistant" else math.atan(half_ratio)
    return min(WIDEST_DEG, math.degrees(2 * half_rad))


def calibration_facts(read: CalibrationRead) -> dict[str, Any]:
    """Name, format, sensors, footprint, the vehicle's limits, boxes and what is missing."""
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
