"""nuScenes: rows of calibrated_sensor.json, with their channels from sensor.json beside it.

**Conventions.** `ego_from_sensor`, quaternions wxyz; some converters write 3 × 3 rotations instead, which are read with
a warning. Cameras are optical and their images rectified; no table contains their size. A table may hold the same
sensor for many scenes; it is one calibration only if they agree.
"""

import numpy as np

from stone.geometry.se3 import SE3
from stone.sensors.calibration import CameraIntrinsics, SensorKind
from stone.sensors.calibration_checks import Findings, quaternion_and_translation, rotation_and_translation, warning
from stone_recordings.calibrations.draft import kind_of
from stone_recordings.calibrations.errors import conflicting_files, half_rig
from stone_recordings.calibrations.part import CalibrationPart, Edge, LensText, Node, intrinsics

EGO = "ego"
MODALITIES: dict[str, SensorKind] = {"camera": "camera", "lidar": "lidar", "radar": "radar"}


def is_calibrated(content: list[object]) -> bool:
    return bool(content) and all(isinstance(row, dict) and "sensor_token" in row for row in content)


def is_sensors(content: list[object]) -> bool:
    return bool(content) and all(isinstance(row, dict) and {"channel", "modality"} <= set(row) for row in content)


def nuscenes(document: Node, sensors: Node | None) -> CalibrationPart:
    """Return every row of the table. Raises `CAL-424` without sensor.json, `CAL-429` for a duplicate channel."""
    if sensors is None:
        raise half_rig(document.file, "its rows name their sensors by token only", "send sensor.json along in a zip")
    named = {row.at("token").text(): (row.at("channel").text(), row.at("modality").text()) for row in sensors.items()}
    edges, findings = dict[str, Edge](), Findings()
    lenses, kinds = dict[str, CameraIntrinsics](), dict[str, SensorKind]()
    for row in document.items():
        channel, modality = named.get(row.at("sensor_token").text(), ("", ""))
        if not channel:
            raise row.at("sensor_token").refused(f"no row of {sensors.file} has this token")
        kind = MODALITIES.get(modality) or kind_of(channel)
        if kind is None:
            continue
        transform, noticed = _transform(channel, kind, row)
        _check_same(document.file, edges.get(channel), transform, channel)
        edges[channel], kinds[channel] = Edge(EGO, channel, transform), kind
        findings += tuple(finding for finding in noticed if finding not in findings)
        if kind == "camera" and row.at("camera_intrinsic").value:
            matrix = row.at("camera_intrinsic").matrix(3, 3)
            lenses[channel] = intrinsics(LensText(document.file, channel, "none", ()), matrix, (0, 0))
    return CalibrationPart(
        document.file, "nuscenes", tuple(edges.values()), lenses, {}, kinds, frozenset(lenses), findings
    )


def _transform(channel: str, kind: SensorKind, row: Node) -> tuple[SE3, Findings]:
    rotation, translation_m = row.at("rotation"), row.at("translation").vector()
    if rotation.items() and isinstance(rotation.items()[0].value, list):
        transform, findings = rotation_and_translation(channel, rotation.matrix(3, 3), translation_m)
        sentence = "the rotation is a 3 x 3 matrix where nuScenes has a quaternion; it is read as one"
        return transform, (*findings, warning("CAL-402", channel, sentence))
    return quaternion_and_translation(channel, kind, rotation.vector(), translation_m)


def _check_same(file: str, before: Edge | None, transform: SE3, channel: str) -> None:
    if before is not None and not np.allclose(before.parent_from_child.as_matrix(), transform.as_matrix(), atol=1e-6):
        raise conflicting_files(file, f"the extrinsics of {channel}", ("two of its rows",))
