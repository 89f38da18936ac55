"""The native format: one YAML document with everything.

**Conventions.** `stone_calibration: 1`; lengths in metres, quaternions wxyz, transforms `dst_from_src`.
"""

from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from stone.errors import Refused
from stone.geometry.se3 import SE3
from stone.sensors.calibration import Box, Calibration, CameraIntrinsics, Footprint, Mount, SensorKind, Vehicle
from stone.sensors.calibration_checks import (
    Findings,
    check_intrinsics,
    check_translation,
    checked_norm,
    checked_transform,
    quaternion_and_translation,
    rotation_and_translation,
)
from stone_files.joined_file import MOST_OFFSET_NS
from stone_recordings.calibrations.errors import bad_calibration_key

# The keys of a native calibration file, and of the rig document that completes others. Unknown keys are refused, so
# that a typo is not a silent default. Values are of the declared kind (no numbers in quotes);
# `stone.sensors.calibration_checks` checks their ranges.


Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
Quaternion = Annotated[list[float], Field(min_length=4, max_length=4)]
Rotation = Annotated[list[Vector], Field(min_length=3, max_length=3)]
Matrix = Annotated[list[Quaternion], Field(min_length=4, max_length=4)]
Name = Annotated[str, Field(min_length=1, max_length=100)]
Pixels = Annotated[int, Field(gt=0, le=100_000)]

FILL_IN = "FILL_IN"  # the placeholder that `stone calibration init` writes for unknown values
ONE_TRANSFORM = "give either matrix, or translation_m with one of rotation_wxyz and rotation_matrix"


class Document(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class TransformDocument(Document):
    """`dst_from_src` in one of three spellings."""

    translation_m: Vector | None = None
    rotation_wxyz: Quaternion | None = None
    rotation_matrix: Rotation | None = None
    matrix: Matrix | None = None

    @model_validator(mode="after")
    def is_one_spelling(self) -> "TransformDocument":
        rotations = (self.rotation_wxyz is not None) + (self.rotation_matrix is not None)
        is_parts = self.translation_m is not None and rotations == 1 and self.matrix is None
        is_matrix = self.matrix is not None and self.translation_m is None and rotations == 0
        if not (is_parts or is_matrix):
            raise ValueError(ONE_TRANSFORM)
        return self


class FootprintDocument(Document):
    length_m: float
    width_m: float


class VehicleDocument(Document):
    """The vehicle's limits; missing ones are the default's."""

    max_slope_deg: Annotated[float, Field(ge=1.0, le=60.0)] = Vehicle().max_slope_deg
    max_step_m: Annotated[float, Field(ge=0.02, le=1.0)] = Vehicle().max_step_m
    height_m: Annotated[float, Field(ge=0.2, le=6.0)] = Vehicle().height_m


class BoxDocument(Document):
    min_m: Vector
    max_m: Vector


class IntrinsicsDocument(Document):
    model: Literal["pinhole", "plumb_bob", "rational_polynomial", "equidistant"]
    width_px: Pixels
    height_px: Pixels
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    distortion: Annotated[list[float], Field(max_length=14)] = []


class SensorDocument(Document):
    kind: Literal["camera", "radar", "ins", "imu", "lidar"]
    lidar_from_sensor: TransformDocument
    frame_id: Annotated[str, Field(max_length=100)] = ""
    time_offset_ns: Annotated[int, Field(ge=-MOST_OFFSET_NS, le=MOST_OFFSET_NS)] = 0
    intrinsics: IntrinsicsDocument | None = None


class CalibrationDocument(Document):
    stone_calibration: Literal[1]
    name: Name
    ego_from_lidar: TransformDocument
    footprint: FootprintDocument | None = None
    vehicle: VehicleDocument | None = None
    self_boxes_ego: Annotated[list[BoxDocument], Field(max_length=100)] = []
    sensors: Annotated[dict[Name, SensorDocument], Field(max_length=100)] = {}


class RigTransform(TransformDocument):
    parent: Name
    child: Name


class RigSensor(Document):
    """`kind` if the frame's name does not reveal it; sizes if the other file lacks them."""

    frame: Name
    kind: Literal["camera", "radar", "ins", "imu", "lidar"] | None = None
    frame_id: Annotated[str, Field(max_length=100)] | None = None
    time_offset_ns: Annotated[int, Field(ge=-MOST_OFFSET_NS, le=MOST_OFFSET_NS)] | None = None
    width_px: Pixels | None = None
    height_px: Pixels | None = None


class RigDocument(Document):
    stone_rig: Literal[1]
    name: Name | None = None
    ego: Name | None = None
    lidar: Name | None = None
    transforms: Annotated[list[RigTransform], Field(max_length=100)] = []
    sensors: Annotated[dict[Name, RigSensor], Field(max_length=100)] = {}
    footprint: FootprintDocument | None = None
    vehicle: VehicleDocument | None = None
    self_boxes_ego: Annotated[list[BoxDocument], Field(max_length=100)] = []


def is_native(content: dict[str, object]) -> bool:
    return "stone_calibration" in content


def native(file: str, content: object) -> tuple[Calibration, Findings]:
    """Read the document. Raises `CAL-453`, `CAL-422` and the errors of checking single transforms and lenses."""
    missing = filled_in(content)
    if missing:
        shown = ", ".join(missing[:12]) + (f" and {len(missing) - 12} more" if len(missing) > 12 else "")
        raise Refused("CAL-453", f"{file} is a template; measure and write in the place of {FILL_IN}: {shown}")
    try:
        document = CalibrationDocument.model_validate(content)
    except ValidationError as error:
        raise key_error(file, error) from None
    ego_from_lidar, findings = transform_of("ego_from_lidar", "lidar", document.ego_from_lidar)
    mounts = []
    for name, sensor in document.sensors.items():
        mount, noticed = _mount(name, sensor)
        mounts.append(mount)
        findings += noticed
    footprint, boxes = footprint_of(document.footprint), boxes_of(document.self_boxes_ego)
    vehicle = vehicle_of(document.vehicle)
    return Calibration(document.name, ego_from_lidar, tuple(mounts), footprint, boxes, vehicle), findings


def filled_in(value: object, key: str = "") -> tuple[str, ...]:
    """Return the keys whose value, or a number in whose list, is still `FILL_IN`."""
    if isinstance(value, dict):
        return tuple(path for name, inner in value.items() for path in filled_in(inner, f"{key}.{name}".lstrip(".")))
    if isinstance(value, list):
        return (key,) if any(filled_in(inner, key) for inner in value) else ()
    return (key,) if value == FILL_IN else ()


def key_error(name: str, error: ValidationError) -> Refused:
    """Return the first complaint, with the key as written by the author."""
    first = error.errors(include_url=False, include_context=False)[0]
    key = ".".join(str(part) for part in first["loc"])[:120]
    problem = first["msg"].removeprefix("Value error, ")
    if not isinstance(first["input"], (dict, list)):
        problem += f", not {str(first['input'])[:40]!r}"
    return bad_calibration_key(name, key, problem, error.error_count() - 1)


def transform_of(name: str, kind: SensorKind | None, document: TransformDocument) -> tuple[SE3, Findings]:
    """Return a transform in any of its spellings; without a kind the order of its quaternion is not checked."""
    if document.matrix is not None:
        return checked_transform(name, np.array(document.matrix))
    translation_m = np.array(document.translation_m)
    if document.rotation_matrix is not None:
        return rotation_and_translation(name, np.array(document.rotation_matrix), translation_m)
    wxyz = np.array(document.rotation_wxyz)
    if kind is not None:
        return quaternion_and_translation(name, kind, wxyz, translation_m)
    findings = checked_norm(name, wxyz) + check_translation(name, translation_m)
    return SE3.from_parts(wxyz, translation_m), findings


def footprint_of(document: FootprintDocument | None) -> Footprint:
    return Footprint(document.length_m, document.width_m) if document else Footprint()


def vehicle_of(document: VehicleDocument | None) -> Vehicle:
    return Vehicle(document.max_slope_deg, document.max_step_m, document.height_m) if document else Vehicle()


def boxes_of(documents: list[BoxDocument]) -> tuple[Box, ...]:
    return tuple(Box(_triple(box.min_m), _triple(box.max_m)) for box in documents)


def _mount(name: str, sensor: SensorDocument) -> tuple[Mount, Findings]:
    lidar_from_sensor, findings = transform_of(name, sensor.kind, sensor.lidar_from_sensor)
    intrinsics = _intrinsics(sensor.intrinsics) if sensor.intrinsics else None
    if intrinsics is not None:
        findings += check_intrinsics(name, intrinsics)
    return Mount(name, sensor.kind, lidar_from_sensor, sensor.frame_id, sensor.time_offset_ns, intrinsics), findings


def _intrinsics(document: IntrinsicsDocument) -> CameraIntrinsics:
    size_px, focal_px = (document.width_px, document.height_px), (document.fx_px, document.fy_px)
    centre_px = (document.cx_px, document.cy_px)
    return CameraIntrinsics(document.model, *size_px, *focal_px, *centre_px, tuple(document.distortion))


def _triple(values: list[float]) -> tuple[float, float, float]:
    x, y, z = values
    return x, y, z
