"""A calibration from its file: read, understood, checked.

**Conventions.** The native format is YAML that begins with `stone_calibration: 1`; lengths in metres, quaternions wxyz,
transforms `dst_from_src`. Findings are what was mended or is doubtful; everything worse is raised.
"""

from pathlib import Path

import numpy as np
from pydantic import ValidationError

from services.ingest.calibration_document import (
    CalibrationDocument,
    IntrinsicsDocument,
    SensorDocument,
    TransformDocument,
)
from services.ingest.calibration_errors import CalibrationFormatError, CalibrationKeyError
from services.ingest.calibration_yaml import read_yaml
from stone.calibration import Box, Calibration, CameraIntrinsics, Footprint, Mount, SensorKind
from stone.calibration_checks import (
    Findings,
    check_calibration,
    checked_transform,
    quaternion_and_translation,
    rotation_and_translation,
)
from stone.camera_checks import check_intrinsics
from stone.se3 import SE3

# A key that only one other format has at its top level.
OTHER_FORMATS = {
    "camera_matrix": "a ROS camera_info file",
    "image_width": "a ROS camera_info file",
    "cam0": "a Kalibr camchain",
    "base_link": "an Autoware sensor_kit_calibration",
    "sensor_kit_base_link": "an Autoware sensor_kit_calibration",
    "calibration_time": "a KITTI calibration",
    "P0": "a KITTI calibration",
    "R_rect_00": "a KITTI calibration",
    "Tr_velo_to_cam": "a KITTI calibration",
}


def read_calibration(path: Path) -> tuple[Calibration, Findings]:
    """The calibration in a native YAML file, and what was mended or is doubtful about it.

    Raises OSError; CalibrationSizeError, CalibrationYamlError, CalibrationFormatError, CalibrationKeyError (the file);
    and the leaves of `stone.calibration_errors` (the numbers).
    """
    content = read_yaml(path)
    _check_format(path.name, content)
    try:
        document = CalibrationDocument.model_validate(content)
    except ValidationError as error:
        raise _key_error(path.name, error) from None
    return _calibration(document)


def _check_format(name: str, content: object) -> None:
    if isinstance(content, list):
        is_nuscenes = bool(content) and isinstance(content[0], dict) and "sensor_token" in content[0]
        raise CalibrationFormatError(name, "a nuScenes calibrated_sensor table" if is_nuscenes else "a list")
    if not isinstance(content, dict):
        raise CalibrationFormatError(name, "an empty file" if content is None else "plain text")
    if "stone_calibration" in content:
        return
    for key, looks_like in OTHER_FORMATS.items():
        if key in content:
            raise CalibrationFormatError(name, looks_like)
    if any(isinstance(value, dict) and "sensor_name" in value for value in content.values()):
        raise CalibrationFormatError(name, "an OpenCalib file")
    raise CalibrationFormatError(name, "another YAML file")


def _key_error(name: str, error: ValidationError) -> CalibrationKeyError:
    """The first complaint, with the key as the author would find it."""
    first = error.errors(include_url=False, include_context=False)[0]
    key = ".".join(str(part) for part in first["loc"])[:120]
    problem = first["msg"].removeprefix("Value error, ")
    if not isinstance(first["input"], (dict, list)):
        problem += f", not {str(first['input'])[:40]!r}"
    return CalibrationKeyError(name, key, problem, error.error_count() - 1)


def _calibration(document: CalibrationDocument) -> tuple[Calibration, Findings]:
    ego_from_lidar, findings = _transform("ego_from_lidar", "lidar", document.ego_from_lidar)
    mounts = []
    for name, sensor in document.sensors.items():
        mount, noticed = _mount(name, sensor)
        mounts.append(mount)
        findings += noticed
    footprint = document.footprint
    calibration = Calibration(
        name=document.name,
        ego_from_lidar=ego_from_lidar,
        mounts=tuple(mounts),
        footprint=Footprint(footprint.length_m, footprint.width_m) if footprint else Footprint(),
        self_boxes_ego=tuple(Box(_triple(box.min_m), _triple(box.max_m)) for box in document.self_boxes_ego),
    )
    return calibration, findings + check_calibration(calibration)


def _mount(name: str, sensor: SensorDocument) -> tuple[Mount, Findings]:
    lidar_from_sensor, findings = _transform(name, sensor.kind, sensor.lidar_from_sensor)
    intrinsics = _intrinsics(sensor.intrinsics) if sensor.intrinsics else None
    if intrinsics is not None:
        findings += check_intrinsics(name, intrinsics)
    return Mount(name, sensor.kind, lidar_from_sensor, sensor.frame_id, sensor.time_offset_ns, intrinsics), findings


def _transform(name: str, kind: SensorKind, document: TransformDocument) -> tuple[SE3, Findings]:
    if document.matrix is not None:
        return checked_transform(name, np.array(document.matrix))
    translation_m = np.array(document.translation_m)
    if document.rotation_matrix is not None:
        return rotation_and_translation(name, np.array(document.rotation_matrix), translation_m)
    return quaternion_and_translation(name, kind, np.array(document.rotation_wxyz), translation_m)


def _intrinsics(document: IntrinsicsDocument) -> CameraIntrinsics:
    return CameraIntrinsics(
        document.model,
        document.width_px,
        document.height_px,
        document.fx_px,
        document.fy_px,
        document.cx_px,
        document.cy_px,
        tuple(document.distortion),
    )


def _triple(values: list[float]) -> tuple[float, float, float]:
    x, y, z = values
    return x, y, z
