"""The native format: one YAML document that says everything.

**Conventions.** `stone_calibration: 1`; lengths in metres, quaternions wxyz, transforms `dst_from_src`.
"""

import numpy as np
from pydantic import ValidationError

from stone.geometry.se3 import SE3
from stone.sensors.calibration import Box, Calibration, CameraIntrinsics, Footprint, Mount, SensorKind
from stone.sensors.calibration_checks import (
    Findings,
    check_intrinsics,
    check_translation,
    checked_norm,
    checked_transform,
    quaternion_and_translation,
    rotation_and_translation,
)
from stone_recordings.calibrations.document import (
    BoxDocument,
    CalibrationDocument,
    FootprintDocument,
    IntrinsicsDocument,
    SensorDocument,
    TransformDocument,
)
from stone_recordings.calibrations.errors import CalibrationKeyError


def is_native(content: dict[str, object]) -> bool:
    return "stone_calibration" in content


def native(file: str, content: object) -> tuple[Calibration, Findings]:
    """Raises CalibrationKeyError and what the checks of single transforms and lenses raise."""
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
    return Calibration(document.name, ego_from_lidar, tuple(mounts), footprint, boxes), findings


def key_error(name: str, error: ValidationError) -> CalibrationKeyError:
    """The first complaint, with the key as the author would find it."""
    first = error.errors(include_url=False, include_context=False)[0]
    key = ".".join(str(part) for part in first["loc"])[:120]
    problem = first["msg"].removeprefix("Value error, ")
    if not isinstance(first["input"], (dict, list)):
        problem += f", not {str(first['input'])[:40]!r}"
    return CalibrationKeyError(name, key, problem, error.error_count() - 1)


def transform_of(name: str, kind: SensorKind | None, document: TransformDocument) -> tuple[SE3, Findings]:
    """A transform in any of its spellings; without a kind the order of its quaternion is not doubted."""
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
