"""RELLIS-3D: transforms.yaml and vel2os1.yaml, quaternion and translation by a pair of frames, and camera_info.txt.

**Conventions.** `a-b: {q: {w, x, y, z}, t: {x, y, z}}` is `a_from_b`: `os1_cloud_node-pylon_camera_node` is the
camera's pose in the LiDAR's frame, whose x points backward; RELLIS-3D's own code inverts it before it projects.
`vel2os1` is `os1_from_vel`, of the clouds' frames (`…_cloud_node`). `camera_info.txt` has `fx fy cx cy` of the pylon
camera and no distortion. Source: utils/lidar2img.ipynb of unmannedlab/RELLIS-3D; the example scan tests both directions
(`tests/stone_recordings/calibrations/test_rellis.py`).
"""

import re

import numpy as np

from stone.findings import Finding
from stone.geometry.se3 import SE3
from stone.sensors.calibration import SensorKind
from stone.sensors.calibration_checks import Findings, check_translation, checked_norm
from stone_recordings.calibrations.draft import kind_of
from stone_recordings.calibrations.errors import bad_calibration_key
from stone_recordings.calibrations.part import CalibrationPart, Edge, LensText, Node, intrinsics

PARENT_CHILD = re.compile(r"(\w+)-(\w+)")
CLOUDS = re.compile(r"(vel|os1)2(vel|os1)")
CAMERA = "pylon_camera_node"
FOUR_NUMBERS = re.compile(r"\s*(?:\d[\d.eE+-]*\s+){3}\d[\d.eE+-]*\s*")


def is_rellis(content: dict[str, object]) -> bool:
    """Return whether these are mappings of q and t."""
    return bool(content) and all(isinstance(value, dict) and {"q", "t"} <= set(value) for value in content.values())


def rellis(document: Node) -> CalibrationPart:
    """Return a part with one edge for each pair. Raises `CAL-422` for a key without two frames."""
    edges, findings = list[Edge](), Findings()
    for key, node in document.entries().items():
        parent, child = _pair(document.file, key)
        wxyz = np.array([node.at("q").at(axis).number() for axis in "wxyz"])
        translation_m = np.array([node.at("t").at(axis).number() for axis in "xyz"])
        findings += checked_norm(child, wxyz) + check_translation(child, translation_m)
        edges.append(Edge(parent, child, SE3.from_parts(wxyz, translation_m)))
    frames = {frame for edge in edges for frame in (edge.parent, edge.child)}
    kinds: dict[str, SensorKind] = {frame: "lidar" for frame in frames if frame.endswith("_cloud_node")}
    optical = frozenset(frame for frame in frames if kind_of(frame) == "camera")
    return CalibrationPart(document.file, "rellis", tuple(edges), kinds=kinds, optical=optical, findings=findings)


def is_camera_text(content: object) -> bool:
    """Return whether the content is four numbers and nothing else."""
    return isinstance(content, str) and FOUR_NUMBERS.fullmatch(content) is not None


def camera_text(document: Node) -> CalibrationPart:
    """Return the lens of the pylon camera, without distortion and image size, which other files contain."""
    fx, fy, cx, cy = (word.number() for word in document.words())
    lens = intrinsics(
        LensText(document.file, CAMERA, "none", ()), np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), (0, 0)
    )
    sentence = f"{document.file} gives no distortion: images count as undistorted (add camera_info to change this)"
    findings = (Finding("CAL-426", "info", CAMERA, sentence),)
    return CalibrationPart(
        document.file, "rellis", lenses={CAMERA: lens}, optical=frozenset({CAMERA}), findings=findings
    )


def _pair(file: str, key: str) -> tuple[str, str]:
    """Return parent and child."""
    if match := CLOUDS.fullmatch(key):
        return f"{match[2]}_cloud_node", f"{match[1]}_cloud_node"
    if match := PARENT_CHILD.fullmatch(key):
        return match[1], match[2]
    raise bad_calibration_key(file, key[:120], "two frames are expected, as in os1_cloud_node-pylon_camera_node", 0)
