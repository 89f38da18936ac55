"""Where every sensor of a calibration sits on the robot and where it looks: what drawings and tables of a rig show.

**Conventions.** In the ego frame, metres. The LiDAR that all others are placed by is the first, called LIDAR where the
file has no name for it. A camera is optical and looks along its z, everything else along its x. Angles are roll, pitch,
yaw about fixed axes (URDF); of a camera they are those of its link (REP 103: x where it looks, z up), so that a level
camera ahead has three zeros.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone.geometry.se3 import SE3
from stone.sensors.calibration import Calibration, CameraIntrinsics, Mount
from stone_recordings.calibrations.assembly import LINK_FROM_OPTICAL
from stone_recordings.calibrations.draft import SAME_M_OR_RATIO

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
