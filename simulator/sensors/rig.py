"""The simulated robot: the mounts and firing times of its sensors.

**Conventions.** Mounts are `ego_from_<sensor>` (x forward, y left, z up; cameras optical) and become
`lidar_from_<sensor>` in the calibration. The LiDAR frame is Hesai's: +y is forward, azimuth grows clockwise from +y. A
sweep starts at `SWEEP_START_RAD`, 15° before it points straight back, so that every camera fires well inside it.
"""

from dataclasses import dataclass
from math import cos, pi, sin, tan

import numpy as np

from stone.geometry.se3 import SE3, Array
from stone.sensors.calibration import Box, Calibration, CameraIntrinsics, Footprint, Mount

SWEEP_NS = 100_000_000
SWEEP_START_RAD = np.deg2rad(165.0)  # clockwise from forward
LIDAR_TOP_RAD = np.deg2rad(15.0)
LIDAR_BOTTOM_RAD = np.deg2rad(-25.0)
LIDAR_NEAR_M = 0.3
LIDAR_FAR_M = 120.0
LIDAR_NOISE_M = 0.02

CAMERA_YAWS_DEG = {
    "CAM_FRONT": 0.0,
    "CAM_FRONT_LEFT": 60.0,
    "CAM_FRONT_RIGHT": -60.0,
    "CAM_BACK": 180.0,
    "CAM_BACK_LEFT": 120.0,
    "CAM_BACK_RIGHT": -120.0,
}
RADARS = {"RADAR_FRONT": (0.50, 0.0, 0.0), "RADAR_LEFT": (0.0, 0.42, 90.0), "RADAR_RIGHT": (0.0, -0.42, -90.0)}
CAMERA_VIEW_RAD = np.deg2rad(80.0)

# The parts of the robot in its LiDAR's view: a box behind the mast and an antenna pole.
BODY_BOXES_EGO = (Box((-0.53, -0.425, 0.05), (0.53, 0.425, 0.55)), Box((-0.50, -0.28, 0.55), (-0.24, 0.16, 0.80)))
POLE_EGO_XY_M = (-0.45, 0.30)
POLE_RADIUS_M = 0.03
POLE_TOP_M = 1.50
SELF_BOXES_EGO = (Box((-0.62, -0.52, 0.0), (0.62, 0.52, 0.90)), Box((-0.56, 0.19, 0.4), (-0.34, 0.41, 1.65)))

EGO_FROM_LIDAR = SE3.from_parts(np.array([cos(pi / 4), 0, 0, -sin(pi / 4)]), np.array([0.0, 0.0, 0.95]))
EGO_FROM_INS = SE3.from_parts(np.array([1.0, 0, 0, 0]), np.array([-0.10, 0.0, 0.40]))
EGO_FROM_IMU = SE3.from_parts(np.array([1.0, 0, 0, 0]), np.array([0.05, 0.02, 0.30]))


@dataclass(frozen=True)
class CameraSpec:
    """One camera of the ring; `phase_ns` is the trigger after the sweep's stamp, when the LiDAR points in its
    direction.
    """

    channel: str
    frame_id: str
    topic: str
    yaw_rad: float
    phase_ns: int


def cameras() -> tuple[CameraSpec, ...]:
    """Return six cameras, 60° apart."""
    return tuple(_camera(channel, float(np.deg2rad(yaw_deg))) for channel, yaw_deg in CAMERA_YAWS_DEG.items())


def _camera(channel: str, yaw_rad: float) -> CameraSpec:
    turned_rad = (-yaw_rad - SWEEP_START_RAD) % (2 * pi)
    mount = channel.removeprefix("CAM_").lower()
    phase_ns = round(turned_rad / (2 * pi) * SWEEP_NS)
    return CameraSpec(channel, f"cam_{mount}", f"/camera/{mount}/image/compressed", yaw_rad, phase_ns)


def camera_info_topic(camera: CameraSpec) -> str:
    return camera.topic.replace("image/compressed", "camera_info")


def ego_from_camera(camera: CameraSpec) -> SE3:
    """Return an optical frame 0.12 m out from the mast at 0.80 m: z along the yaw, y down."""
    c, s = cos(camera.yaw_rad), sin(camera.yaw_rad)
    matrix = np.eye(4)
    matrix[:3, :3] = np.array([[s, 0, c], [-c, 0, s], [0, -1, 0]])
    matrix[:3, 3] = (0.12 * c, 0.12 * s, 0.80)
    return SE3.from_matrix(matrix)


def ego_from_radar(channel: str) -> SE3:
    """Return a radar frame: x forward, y left, z up at 0.50 m."""
    x, y, yaw_deg = RADARS[channel]
    half = np.deg2rad(yaw_deg) / 2
    return SE3.from_parts(np.array([cos(half), 0, 0, sin(half)]), np.array([x, y, 0.50]))


def intrinsics(width_px: int) -> CameraIntrinsics:
    """Return a 16:10 pinhole camera with square pixels and 80° of horizontal view."""
    height_px = round(width_px * 0.625)
    focal_px = width_px / 2 / tan(CAMERA_VIEW_RAD / 2)
    centre = ((width_px - 1) / 2, (height_px - 1) / 2)
    return CameraIntrinsics("plumb_bob", width_px, height_px, focal_px, focal_px, *centre, (0.0,) * 5)


def calibration(camera_width_px: int) -> Calibration:
    """Return the rig's calibration: exactly the simulated mounts."""
    lidar_from_ego = EGO_FROM_LIDAR.inverse()
    lens = intrinsics(camera_width_px)
    mounts = [
        Mount(camera.channel, "camera", lidar_from_ego @ ego_from_camera(camera), camera.frame_id, 0, lens)
        for camera in cameras()
    ]
    mounts += [
        Mount(channel, "radar", lidar_from_ego @ ego_from_radar(channel), radar_frame_id(channel)) for channel in RADARS
    ]
    mounts.append(Mount("INS", "ins", lidar_from_ego @ EGO_FROM_INS, "gps"))
    mounts.append(Mount("IMU", "imu", lidar_from_ego @ EGO_FROM_IMU, "imu_link"))
    return Calibration("stone-sim", EGO_FROM_LIDAR, tuple(mounts), Footprint(), SELF_BOXES_EGO)


def radar_frame_id(channel: str) -> str:
    return channel.lower()


def radar_topic(channel: str) -> str:
    return f"/radar/{channel.removeprefix('RADAR_').lower()}/detections"


def sweep_steps(columns: int) -> int:
    """Return the pose steps of a sweep: the largest divisor of `columns` up to 100, one whole packet per step."""
    return max(steps for steps in range(1, 101) if columns % steps == 0)


def lidar_directions(channels: int, columns: int) -> Array:
    """Return unit rays (columns, channels, 3) in the LiDAR frame, in firing order; ring 0 is the top beam."""
    azimuth = SWEEP_START_RAD + 2 * pi * np.arange(columns) / columns
    elevation = np.linspace(LIDAR_TOP_RAD, LIDAR_BOTTOM_RAD, channels)
    flat = np.cos(elevation)[None, :]
    x, y = np.sin(azimuth)[:, None] * flat, np.cos(azimuth)[:, None] * flat
    return np.stack([x, y, np.broadcast_to(np.sin(elevation), x.shape)], axis=-1)
