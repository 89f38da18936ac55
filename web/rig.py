"""A calibration as a drawing: where each sensor sits on the robot and where it looks, from above and from the side.

**Conventions.** Drawn in centimetres; from above forward is up and left is left, from the side forward is right and up
is up. Cameras are optical (z forward), everything else looks along its x.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

from api.errors import CalibrationRefusedError
from api.views import calibration_reading
from services.runtime.store.protocol import Store
from stone.sensors.calibration import Calibration, Mount, Vehicle
from stone_recordings.report.rig.record import PlacedSensor, fields_of_view_deg, placed_sensors

Flat = Callable[[tuple[float, float, float]], tuple[float, float]]
"""A point or direction of the ego frame as it is drawn: right and down."""
CM = 100.0
HELD = 64
MARGIN_CM = (62.0, 20.0)
"""Room beside and above what is drawn, for names."""
LETTER_CM, LINE_CM = 6.0, 11.0
"""Size of a letter and of a line of a name in the drawing."""
IN_PLANE = 0.6
"""A direction with a smaller component in the plane of a view is drawn without a wedge."""
REACH_CM = 55.0
"""Drawn length of a field of view."""
OTHER_FOV_RAD = math.radians(110.0)
FARTHEST_M = 30.0
"""Sensors farther away are left out of the drawing, not of the table."""


@dataclass(frozen=True)
class Mark:
    """A sensor in a view: its position, the wedge of its field of view (an SVG path, empty if all around), and its
    label.

    The label is empty if it would overlap another.
    """

    name: str
    label: str
    kind: str
    x: float
    y: float
    wedge: str
    label_x: float
    label_y: float
    anchor: str


@dataclass(frozen=True)
class RigView:
    """A side of the robot; `body` is the rectangle (x, y, width, height) of its footprint or of its height."""

    title: str
    box: str
    width: float
    height: float
    body: tuple[float, float, float, float]
    marks: tuple[Mark, ...]


@dataclass(frozen=True)
class RigDrawing:
    """`left_out` are sensors that lie too far away to be drawn; `vehicle` are the limits of the robot."""

    views: tuple[RigView, ...]
    sensors: tuple[PlacedSensor, ...]
    left_out: tuple[str, ...]
    vehicle: Vehicle


@dataclass(frozen=True)
class _PlacedMount:
    mount: Mount
    at_m: tuple[float, float, float]
    looks: tuple[float, float, float]


def rig_of(calibration: Calibration) -> RigDrawing:
    """Return the drawing. The LiDAR is the sensor that all the others are placed by."""
    sensors = placed_sensors(calibration)
    placed = [_placed(sensor) for sensor in sensors]
    near = [mount for mount in placed if max(map(abs, mount.at_m)) <= FARTHEST_M]
    half_m = (calibration.footprint.length_m / 2, calibration.footprint.width_m / 2)
    top = _view("From above", near, lambda p: (-p[1], -p[0]), (half_m[1], half_m[0]))
    side = _view("From the right", near, lambda p: (p[0], -p[2]), (half_m[0], 0.0))
    left_out = tuple(mount.mount.name for mount in placed if mount not in near)
    return RigDrawing((top, side), tuple(sensors), left_out, calibration.vehicle)


@lru_cache(HELD)
def stored_rig(store: Store, object_key: str, filename: str) -> tuple[RigDrawing | None, str]:
    """Return the drawing of a stored file, or the reason why this release cannot read it."""
    try:
        return rig_of(calibration_reading.read_stored(store, object_key, filename)), ""
    except CalibrationRefusedError as refused:
        return None, str(refused)


def _placed(sensor: PlacedSensor) -> _PlacedMount:
    x, y, z = sensor.at_m.tolist()
    along_x, along_y, along_z = sensor.looks.tolist()
    return _PlacedMount(sensor.mount, (x, y, z), (along_x, along_y, along_z))


def _view(title: str, placed: list[_PlacedMount], flat: Flat, half_m: tuple[float, float]) -> RigView:
    """Return a view sized to fit its marks."""
    marks = _uncluttered([_mark(mount, flat(mount.at_m), flat(mount.looks)) for mount in placed])
    body_height = 2 * half_m[1] * CM
    body = (-half_m[0] * CM, -half_m[1] * CM if body_height else -35.0, 2 * half_m[0] * CM, body_height or 35.0)
    seen = REACH_CM if any(mark.wedge for mark in marks) else 0.0
    spans = []
    for margin, at, start, length in ((MARGIN_CM[0], "x", body[0], body[2]), (MARGIN_CM[1], "y", body[1], body[3])):
        places = [*(getattr(mark, at) for mark in marks), start, start + length]
        low, high = min(places) - seen - margin, max(places) + seen + margin
        spans.append((low, high - low))
    (left, width), (top, height) = spans
    return RigView(title, f"{left:.1f} {top:.1f} {width:.1f} {height:.1f}", round(width), round(height), body, marks)


def _mark(one: _PlacedMount, at: tuple[float, float], looks: tuple[float, float]) -> Mark:
    x, y = at[0] * CM, at[1] * CM
    flat = math.hypot(*looks)
    is_round = one.mount.kind in ("lidar", "imu", "ins") or flat < IN_PLANE
    heading = math.atan2(looks[1], looks[0])
    wedge = "" if is_round else _wedge(x, y, heading, _fov_rad(one.mount))
    out = (0.0, -1.0) if is_round else (math.cos(heading), math.sin(heading))
    far = 14.0 if is_round else REACH_CM + 8.0
    anchor = "middle" if abs(out[0]) < 0.35 else ("start" if out[0] > 0 else "end")
    name = one.mount.name
    label = name.removeprefix("CAM_").removeprefix("RADAR_").replace("_", " ").lower()
    if is_round and one.mount.kind in ("camera", "radar"):
        label = ""  # it points at or away from the viewer; the other view names it
    return Mark(name, label, one.mount.kind, x, y, wedge, x + out[0] * far, y + out[1] * far + 4.0, anchor)


def _uncluttered(marks: list[Mark]) -> tuple[Mark, ...]:
    """Return the marks without labels that would overlap an earlier one."""
    taken: list[tuple[float, float, float]] = []
    shown: list[Mark] = []
    for mark in marks:
        width = LETTER_CM * len(mark.label)
        left = mark.label_x - {"start": 0.0, "middle": width / 2, "end": width}[mark.anchor]
        is_free = all(
            abs(mark.label_y - y) >= LINE_CM or left >= other + wide or other >= left + width
            for other, y, wide in taken
        )
        if is_free:
            taken.append((left, mark.label_y, width))
        shown.append(mark if is_free else replace(mark, label=""))
    return tuple(shown)


def _fov_rad(mount: Mount) -> float:
    """Return the horizontal field of view of a camera; for a radar a typical one."""
    lens = mount.intrinsics
    return OTHER_FOV_RAD if lens is None else math.radians(fields_of_view_deg(lens)[0])


def _wedge(x: float, y: float, heading: float, fov_rad: float) -> str:
    half = min(fov_rad, math.radians(170.0)) / 2
    ends = [(x + REACH_CM * math.cos(heading + a), y + REACH_CM * math.sin(heading + a)) for a in (-half, half)]
    (x0, y0), (x1, y1) = ends
    return f"M{x:.1f} {y:.1f}L{x0:.1f} {y0:.1f}A{REACH_CM:.0f} {REACH_CM:.0f} 0 0 1 {x1:.1f} {y1:.1f}Z"
