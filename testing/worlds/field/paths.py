"""Drives along any path between pillars and walls, whose sweeps show every motion, and sources with wrong poses.

**Conventions.** As in `testing.worlds.field.drive`; a path returns x, y, z in metres and yaw in radians at times (N,).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testing.worlds.field import drive as field_drive
from testing.worlds.field.drive import COLUMNS, LIDAR_UP_M, RINGS, SWEEP_S, VELODYNE, Array, FieldDrive, Points

Path = Callable[[Any], tuple[Any, Any, Any, Any]]
GROUND_RINGS = 9
WALLS_M, HIGH_M = (-14.0, 22.0, -13.0, 15.0), 3.0
PILLARS = np.random.default_rng(41).uniform((-13, -12, 0.25), (21, 14, 0.9), (40, 3))
PILLARS = PILLARS[(np.abs(PILLARS[:, 1]) > 3.5)]


def level(x: Array, y: Array, yaw: Array) -> tuple[Any, Any, Any, Any]:
    """Return positions on the ground."""
    return x, y, field_drive.ground_m(x, y), yaw


def straight(t: Any) -> tuple[Any, Any, Any, Any]:
    """Return a straight path along x."""
    t = np.asarray(t, np.float64)
    return level(1.5 * t, 0 * t, 0 * t)


def reversing(t: Any) -> tuple[Any, Any, Any, Any]:
    """Return the drive's own path backwards: the robot faces away from its motion."""
    x, y, z, yaw = field_drive.pose(t)
    return x, y, z, yaw + np.pi


def crabbing(t: Any) -> tuple[Any, Any, Any, Any]:
    """Return the drive's own path for a robot that always faces along x."""
    x, y, z, yaw = field_drive.pose(t)
    return x, y, z, 0 * yaw


def standing(t: Any) -> tuple[Any, Any, Any, Any]:
    """Return the poses of a standing robot with a receiver noise of one millimetre."""
    t = np.asarray(t, np.float64)
    return level(1e-3 * np.sin(9 * t), 1e-3 * np.cos(7 * t), 0.3 + 0 * t)


@dataclass(frozen=True)
class PathDrive(FieldDrive):
    """A drive along another path, between pillars."""

    path: Path = field_drive.pose

    def points(self, t: float, record: np.dtype[Any] = VELODYNE) -> tuple[Points, Array]:
        azimuth = np.repeat(np.arange(COLUMNS) * 2 * np.pi / COLUMNS, RINGS)
        ring = np.tile(np.arange(RINGS), COLUMNS)
        after_s = azimuth * SWEEP_S / (2 * np.pi)
        x, y, z, yaw = self.path(t + after_s)
        away_m, seen_m = np.where(ring < GROUND_RINGS, 1.5 * 1.3**ring, np.inf), walls_m(x, y, yaw + azimuth)
        is_wall, away_m = away_m > seen_m, np.minimum(away_m, seen_m)
        height_m = field_drive.ground_m(x + away_m * np.cos(yaw + azimuth), y + away_m * np.sin(yaw + azimuth))
        up_m = np.where(is_wall, HIGH_M * ring / RINGS, height_m - z - LIDAR_UP_M)
        points = np.zeros(len(ring), record)
        points["x"], points["y"], points["z"] = away_m * np.cos(azimuth), away_m * np.sin(azimuth), up_m
        points["ring"], points["intensity"] = ring, 30
        return points, after_s

    def pose_message(self, t: float) -> Any:
        x, y, z, yaw = map(float, self.path(t))
        turn = self.of("geometry_msgs/msg/Quaternion", 0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2)))
        return self.of("geometry_msgs/msg/Pose", self.of("geometry_msgs/msg/Point", x, y, z), turn)

    def imu(self, t: float, frame_id: str = "base_link") -> Any:
        message = super().imu(t, frame_id)
        message.angular_velocity.z = float((self.path(t + 0.01)[3] - self.path(t)[3]) * 100)
        return message

    def fix(self, t: float, frame_id: str = "base_link") -> Any:
        message, (x, y, z, _yaw) = super().fix(t, frame_id), map(float, self.path(t))
        message.latitude, message.longitude, message.altitude = 49.0149 + y / 111_200, 8.3887 + x / 73_010, 312.6 + z
        return message


def walls_m(x: Array, y: Array, azimuth: Array) -> NDArray[np.float64]:
    """Return the distance of a pillar or a wall from points (N,) of the map in directions (N,)."""
    east, north = np.cos(azimuth) + 1e-9, np.sin(azimuth) + 1e-9  # no direction is along a wall
    to_x = np.where(east > 0, WALLS_M[1] - x, WALLS_M[0] - x) / east
    to_y = np.where(north > 0, WALLS_M[3] - y, WALLS_M[2] - y) / north
    nearest = np.minimum(to_x, to_y)
    for at_x, at_y, radius in PILLARS:
        along = (at_x - x) * east + (at_y - y) * north
        aside = (at_x - x) * north - (at_y - y) * east
        hit = along - np.sqrt(np.maximum(radius**2 - aside**2, 0.0))
        nearest = np.where((np.abs(aside) < radius) & (hit > 0.5) & (hit < nearest), hit, nearest)
    return np.asarray(nearest)
