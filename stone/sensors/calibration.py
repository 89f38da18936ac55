"""The calibration of a robot: sensor mounts, camera intrinsics, footprint and vehicle limits.

**Conventions.** Extrinsics are `lidar_from_<sensor>`. The ego frame is the base link: x forward, y left, z up, with its
origin on the ground contact plane under the robot (REP 103/105). Cameras are optical: z forward, x right, y down.
"""

from dataclasses import dataclass, field
from typing import Literal

from stone.geometry.se3 import SE3

CameraModel = Literal["pinhole", "plumb_bob", "rational_polynomial", "equidistant"]
SensorKind = Literal["camera", "radar", "ins", "imu", "lidar"]


@dataclass(frozen=True)
class Box:
    """An axis-aligned, half-open box: min ≤ p < max, metres, in the frame that its owner defines."""

    min_m: tuple[float, float, float]
    max_m: tuple[float, float, float]


@dataclass(frozen=True)
class Footprint:
    """The rectangle of ground that the robot covers, centred on the ego origin (paper, IV: 1.06 × 0.85 m)."""

    length_m: float = 1.06
    width_m: float = 0.85


@dataclass(frozen=True)
class Vehicle:
    """The vehicle's limits: the slope of the ground under its footprint, a step up or down, and its height.

    Profile `field` labels ground beyond a limit non-traversable, even if it resembles the driven ground. The defaults
    are conservative values for a wheeled robot of the paper's size, not the paper's.
    """

    max_slope_deg: float = 20.0
    max_step_m: float = 0.12
    height_m: float = 1.6

    @property
    def is_default(self) -> bool:
        """Whether all limits are the defaults."""
        return self == Vehicle()


@dataclass(frozen=True)
class CameraIntrinsics:
    """`distortion` has the length that its model requires: pinhole 0, plumb_bob 5, rational_polynomial 8, equidistant
    4.
    """

    model: CameraModel
    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    distortion: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class Mount:
    """One sensor on the robot; `name` is its channel (CAM_FRONT, RADAR_LEFT, INS, …)."""

    name: str
    kind: SensorKind
    lidar_from_sensor: SE3
    frame_id: str = ""
    time_offset_ns: int = 0
    intrinsics: CameraIntrinsics | None = None


@dataclass(frozen=True, eq=False)
class Calibration:
    """All fixed properties of one robot; immutable, and every sequence refers to one version."""

    name: str
    ego_from_lidar: SE3
    mounts: tuple[Mount, ...] = ()
    footprint: Footprint = field(default_factory=Footprint)
    self_boxes_ego: tuple[Box, ...] = ()
    vehicle: Vehicle = field(default_factory=Vehicle)

    def mount(self, name: str) -> Mount | None:
        """Return the mount of this channel, or None if the calibration does not have it."""
        return next((mount for mount in self.mounts if mount.name == name), None)

    def of_kind(self, kind: SensorKind) -> tuple[Mount, ...]:
        return tuple(mount for mount in self.mounts if mount.kind == kind)


def entry_of(mount: Mount | SE3) -> str:
    """Return the entry of a mount, or of the LiDAR's mount, as users write it."""
    name = f"lidar_from_sensor of {mount.name}" if isinstance(mount, Mount) else "ego_from_lidar"
    transform = mount.lidar_from_sensor if isinstance(mount, Mount) else mount
    position = ", ".join(f"{value:.3f}" for value in transform.translation_m.tolist())
    turn = ", ".join(f"{value:.5f}" for value in transform.wxyz.tolist())
    return f"{name} at [{position}] m, wxyz [{turn}]"
