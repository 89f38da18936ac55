"""Kalibr: camchain and camchain-imucam (ETH), also written by OpenVINS and msckf_vio.

**Conventions.** `T_cam_imu` maps IMU to camera coordinates, `T_cn_cnm1` those of the previous camera to this one's;
OpenVINS' older files give `T_imu_cam`, the inverse. `timeshift_cam_imu`: t_imu = t_cam + shift, so it is added to the
camera's stamps. Distortion: radtan 4, equidistant 4, none. Source: Kalibr wiki, "YAML formats".
"""

import re

import numpy as np

from stone.sensors.calibration import CameraIntrinsics, SensorKind
from stone.sensors.calibration_checks import Findings, checked_transform
from stone_recordings.calibrations.errors import unread_lens_model
from stone_recordings.calibrations.part import CalibrationPart, Edge, LensText, Node, distortion_of, intrinsics

CAMERA = re.compile(r"cam(\d{1,3})")
IMU = re.compile(r"imu\d{1,3}")
IMU_FRAME = "imu0"


def is_camchain(content: dict[str, object]) -> bool:
    return any(CAMERA.fullmatch(key) for key in content)


def is_imu(content: dict[str, object]) -> bool:
    """Return whether this is imu.yaml: noise densities, and one IMU's pose to another, which a rig does not need."""
    return any(IMU.fullmatch(key) for key in content)


def camchain(document: Node) -> CalibrationPart:
    """Return cameras cam0, cam1, … and, if they are given relative to it, imu0; never a LiDAR."""
    edges, findings = list[Edge](), Findings()
    lenses, offsets_ns = dict[str, CameraIntrinsics](), dict[str, int]()
    for name, camera in document.entries().items():
        if not (match := CAMERA.fullmatch(name)):
            continue
        lenses[name] = _lens(name, camera)
        if camera.has("timeshift_cam_imu"):
            offsets_ns[name] = camera.at("timeshift_cam_imu").offset_ns()
        for edge, noticed in _edges(name, int(match[1]), camera):
            edges.append(edge)
            findings += noticed
    has_imu = any(edge.child == IMU_FRAME for edge in edges)
    kinds: dict[str, SensorKind] = {IMU_FRAME: "imu"} if has_imu else {}
    return CalibrationPart(
        document.file, "kalibr", tuple(edges), lenses, offsets_ns, kinds, frozenset(lenses), findings
    )


def _edges(name: str, number: int, camera: Node) -> list[tuple[Edge, Findings]]:
    others = {"T_cam_imu": IMU_FRAME, "T_cn_cnm1": f"cam{number - 1}"}
    edges = []
    for key, other in others.items():
        if camera.has(key):
            transform, noticed = checked_transform(name, camera.at(key).matrix(4, 4))
            edges.append((Edge(name, other, transform), noticed))
    if camera.has("T_imu_cam"):
        transform, noticed = checked_transform(name, camera.at("T_imu_cam").matrix(4, 4))
        edges.append((Edge(name, IMU_FRAME, transform.inverse()), noticed))
    return edges


def _lens(name: str, camera: Node) -> CameraIntrinsics:
    model, distorted = camera.at("camera_model").text(), camera.at("distortion_model").text()
    if model != "pinhole":
        raise unread_lens_model(camera.file, name, model)
    numbers = camera.at("intrinsics").vector()
    if numbers.shape != (4,):
        raise camera.at("intrinsics").refused("four numbers fu, fv, pu, pv are expected")
    fu, fv, pu, pv = numbers.tolist()
    resolution = camera.at("resolution").items()
    if len(resolution) != 2:
        raise camera.at("resolution").refused("width and height are expected")
    text = LensText(camera.file, name, distorted, distortion_of(camera.at("distortion_coeffs")))
    matrix = np.array([[fu, 0, pu], [0, fv, pv], [0, 0, 1]])
    return intrinsics(text, matrix, (resolution[0].whole(), resolution[1].whole()))
