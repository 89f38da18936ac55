"""Differences between two calibrations of one robot: each sensor's shift, turn and lens changes.

**Conventions.** From `before` to `after`. A shift is the difference in metres of the sensor's origin in the LiDAR frame
(for the LiDAR: in the ego frame). A turn is the angle between the two orientations, in degrees in [0, 180].
"""

from dataclasses import asdict, dataclass, fields
from typing import Literal

import numpy as np

from stone.geometry.se3 import SE3, multiply
from stone.sensors.calibration import Calibration, CameraIntrinsics, Mount, SensorKind

Status = Literal["same", "changed", "added", "removed"]
# Smaller differences are file rounding.
SAME_M, SAME_DEG = 1e-6, 1e-5


@dataclass(frozen=True)
class TransformChange:
    """All zero for equal transforms."""

    translation_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    distance_m: float = 0.0
    rotation_deg: float = 0.0

    @property
    def is_same(self) -> bool:
        return self.distance_m <= SAME_M and self.rotation_deg <= SAME_DEG


@dataclass(frozen=True)
class ValueChange:
    """One changed value of a lens, a sensor's frame or the robot; None if one side has no such value."""

    key: str
    before: float | str | None
    after: float | str | None


@dataclass(frozen=True)
class SensorChange:
    """One channel; `transform` and `time_offset_ns` are zero if it was added or removed."""

    name: str
    kind: SensorKind
    status: Status
    transform: TransformChange = TransformChange()
    time_offset_ns: int = 0
    values: tuple[ValueChange, ...] = ()


@dataclass(frozen=True)
class CalibrationDifference:
    """`sensors` in the order of `after`, then removed ones; `robot` are changes of footprint and limits."""

    ego_from_lidar: TransformChange
    sensors: tuple[SensorChange, ...]
    robot: tuple[ValueChange, ...] = ()

    @property
    def is_same(self) -> bool:
        is_moved = any(sensor.status != "same" for sensor in self.sensors)
        return self.ego_from_lidar.is_same and not is_moved and not self.robot


def difference(before: Calibration, after: Calibration) -> CalibrationDifference:
    """Return the differences by channel name."""
    sensors = [_sensor(before.mount(mount.name), mount) for mount in after.mounts]
    gone = (mount for mount in before.mounts if after.mount(mount.name) is None)
    sensors += [SensorChange(mount.name, mount.kind, "removed") for mount in gone]
    moved = transform_change(before.ego_from_lidar, after.ego_from_lidar)
    return CalibrationDifference(moved, tuple(sensors), _changed(_robot(before), _robot(after)))


def transform_change(before: SE3, after: SE3) -> TransformChange:
    """Return the change between two single transforms."""
    shift_m = after.translation_m - before.translation_m
    turn = multiply(before.wxyz * (1.0, -1.0, -1.0, -1.0), after.wxyz)
    angle_rad = 2 * np.arctan2(np.linalg.norm(turn[1:]), abs(turn[0]))
    x, y, z = shift_m.tolist()
    return TransformChange((x, y, z), float(np.linalg.norm(shift_m)), float(np.rad2deg(angle_rad)))


def _sensor(before: Mount | None, after: Mount) -> SensorChange:
    if before is None:
        return SensorChange(after.name, after.kind, "added")
    transform = transform_change(before.lidar_from_sensor, after.lidar_from_sensor)
    offset_ns = after.time_offset_ns - before.time_offset_ns
    values = _changed({**_facts(before), **_lens(before.intrinsics)}, {**_facts(after), **_lens(after.intrinsics)})
    is_same = transform.is_same and offset_ns == 0 and not values
    return SensorChange(after.name, after.kind, "same" if is_same else "changed", transform, offset_ns, values)


def _robot(calibration: Calibration) -> dict[str, float | str | None]:
    return asdict(calibration.vehicle) | {f"footprint_{key}": m for key, m in asdict(calibration.footprint).items()}


def _facts(mount: Mount) -> dict[str, float | str | None]:
    return {"kind": mount.kind, "frame_id": mount.frame_id}


def _lens(intrinsics: CameraIntrinsics | None) -> dict[str, float | str | None]:
    if intrinsics is None:
        return {}
    values = {entry.name: getattr(intrinsics, entry.name) for entry in fields(intrinsics) if entry.name != "distortion"}
    return values | {f"distortion_{index}": value for index, value in enumerate(intrinsics.distortion)}


def _changed(before: dict[str, float | str | None], after: dict[str, float | str | None]) -> tuple[ValueChange, ...]:
    keys = dict.fromkeys((*before, *after))
    changes = (ValueChange(key, before.get(key), after.get(key)) for key in keys)
    return tuple(change for change in changes if change.before != change.after)
