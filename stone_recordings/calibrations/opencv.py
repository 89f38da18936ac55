"""OpenCV: files of `cv::FileStorage` (`%YAML:1.0`, later `%YAML 1.2`), whose matrices are tagged `!!opencv-matrix`.

**Conventions.** Distortion in OpenCV's order with 4, 5, 8, 12 or 14 numbers, `fisheye_model: 1` with 4; models with
thin prisms or a tilted sensor are refused. Transforms, by their keys:

- `R`, `T` beside `M1`, `M2` or `cameraMatrix1`, `cameraMatrix2` (stereoCalibrate): `second_from_first`; the cameras
  are called camera_left and camera_right as in OpenCV's sample;
- `R`, `T` beside one camera matrix (solvePnP, calibrateCamera): `camera_from_points`, here `camera_from_lidar`;
- `CameraExtrinsicMat` (Autoware.AI): `lidar_from_camera`; the identity, which its camera calibrator writes, is ignored;
- `a_T_b` (`body_T_cam0` of VINS-Fusion): `a_from_b`, where `body` is the IMU.

A file with one camera names it by `camera_name`, else by its own name. If a transform makes the camera lie on its side
and its inverse does not, the transform is still read by its key, with a warning. Source: OpenCV 4, calib3d and
persistence; Autoware.AI points2image (inverts it); VINS-Fusion config.
"""

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone.geometry.se3 import SE3
from stone.sensors.calibration import CameraIntrinsics, SensorKind
from stone.sensors.calibration_checks import Findings, checked_transform, rotation_and_translation, warning
from stone.sensors.camera_views import UPRIGHT_LEAST
from stone_recordings.calibrations.draft import kind_of
from stone_recordings.calibrations.errors import unread_lens_model
from stone_recordings.calibrations.part import CalibrationPart, Edge, LensText, Node, intrinsics
from stone_recordings.calibrations.plain_yaml import OpenCvMatrix

LIDAR, BODY, LEFT, RIGHT = "lidar", "body", "camera_left", "camera_right"
PAIR = re.compile(r"(\w+?)_T_(\w+)")
# The keys of camera matrix and distortion: for the only camera of a file, for the first and the second of a pair.
ALONE = (
    ("camera_matrix", "distortion_coefficients"),
    ("Camera_Matrix", "Distortion_Coefficients"),
    ("CameraMat", "DistCoeff"),
    ("cameraMatrix", "distCoeffs"),
    ("K", "D"),
)
PAIRED = ((("M1", "D1"), ("M2", "D2")), (("cameraMatrix1", "distCoeffs1"), ("cameraMatrix2", "distCoeffs2")))
SIZES = (("image_width", "image_height"), ("image_Width", "image_Height"))
SIZE_LISTS = ("ImageSize", "imageSize", "image_size", "size")
RATIONAL = 8


def is_opencv(content: dict[str, object]) -> bool:
    """Return whether the document has a tagged matrix, or a stereo pair's lenses without the tags (Nerian)."""
    is_pair = any(first[0] in content and second[0] in content for first, second in PAIRED)
    return is_pair or any(isinstance(value, OpenCvMatrix) for value in content.values())


@dataclass(frozen=True)
class _OpenCvCamera:
    name: str
    matrix: Node
    distortion: Node | None


def opencv(document: Node, stem: str) -> CalibrationPart:
    """Return lenses and transforms of one file. Raises `CAL-422` if it has neither."""
    cameras = _cameras(document, stem)
    lenses = {camera.name: _lens(document, camera) for camera in cameras}
    edges, findings = list[Edge](), Findings()
    for edge, noticed in _edges(document, [camera.name for camera in cameras] or [stem]):
        edges.append(edge)
        findings += noticed
    if not lenses and not edges:
        raise document.refused("no camera matrix and no transform under a known key was found")
    frames = {frame for edge in edges for frame in (edge.parent, edge.child)}
    kinds: dict[str, SensorKind] = {LIDAR: "lidar", BODY: "imu"}
    optical = frozenset(lenses) | {frame for frame in frames if kind_of(frame) == "camera"}
    placed = {frame: kind for frame, kind in kinds.items() if frame in frames and frame not in lenses}
    placed |= {frame: "camera" for frame in frames if frame not in kinds}
    return CalibrationPart(document.file, "opencv", tuple(edges), lenses, {}, placed, optical, findings)


def _cameras(document: Node, stem: str) -> list[_OpenCvCamera]:
    for both in PAIRED:
        if all(document.has(key) for key, _ in both):
            return [_camera(document, name, *keys) for name, keys in zip((LEFT, RIGHT), both, strict=True)]
    name = document.at("camera_name").text() if document.has("camera_name") else stem
    return [_camera(document, name, *keys) for keys in ALONE if document.has(keys[0])][:1]


def _camera(document: Node, name: str, matrix: str, distortion: str) -> _OpenCvCamera:
    return _OpenCvCamera(name, document.at(matrix), document.at(distortion) if document.has(distortion) else None)


def _lens(document: Node, camera: _OpenCvCamera) -> CameraIntrinsics:
    given = tuple(_numbers(camera.distortion).tolist()) if camera.distortion is not None else ()
    is_fisheye = document.has("fisheye_model") and document.at("fisheye_model").number() != 0
    if len(given) in (12, 14) and not any(given[RATIONAL:]):
        given = given[:RATIONAL]
    models = {0: "none", 4: "radtan", 5: "plumb_bob", RATIONAL: "rational_polynomial"}
    model = "equidistant" if is_fisheye else models.get(len(given))
    if model is None:
        raise unread_lens_model(document.file, camera.name, f"OpenCV's with {len(given)} coefficients")
    text = LensText(document.file, camera.name, model, given)
    return intrinsics(text, _sized(camera.matrix, 3, 3), _size_px(document))


def _size_px(document: Node) -> tuple[int, int]:
    """Return width and height; zeros if the file lacks them."""
    for width, height in SIZES:
        if document.has(width) and document.has(height):
            return document.at(width).whole(), document.at(height).whole()
    for key in SIZE_LISTS:
        if document.has(key):
            sides = document.at(key).items()
            if len(sides) != 2:
                raise document.at(key).refused("width and height are expected")
            return sides[0].whole(), sides[1].whole()
    return 0, 0


def _edges(document: Node, cameras: list[str]) -> list[tuple[Edge, Findings]]:
    edges = list[tuple[Edge, Findings]]()
    if document.has("R") and document.has("T"):
        rotation, translation_m = _sized(document.at("R"), 3, 3), _sized(document.at("T"), 3, 1).ravel()
        transform, noticed = rotation_and_translation(cameras[-1], rotation, translation_m)
        child = cameras[0] if len(cameras) == 2 else LIDAR
        doubts = _doubt(cameras[-1], transform.inverse()) if child == LIDAR else ()
        edges.append((Edge(cameras[-1], child, transform), noticed + doubts))
    if document.has("CameraExtrinsicMat"):
        matrix = _sized(document.at("CameraExtrinsicMat"), 4, 4)
        transform, noticed = checked_transform(cameras[0], matrix)
        if not np.array_equal(matrix, np.eye(4)):
            edges.append((Edge(LIDAR, cameras[0], transform), noticed + _doubt(cameras[0], transform)))
    for key, node in document.entries().items():
        if pair := PAIR.fullmatch(key):
            transform, noticed = checked_transform(pair[2], _sized(node, 4, 4))
            edges.append((Edge(pair[1], pair[2], transform), noticed))
    return edges


def _doubt(camera: str, lidar_from_camera: SE3) -> Findings:
    """Return a warning if only the inverse would hold the camera upright on an upright LiDAR."""
    up, up_of_inverse = (
        pose.rotation()[2] @ (0.0, -1.0, 0.0) for pose in (lidar_from_camera, lidar_from_camera.inverse())
    )
    if up >= UPRIGHT_LEAST or up_of_inverse < UPRIGHT_LEAST:
        return ()
    sentence = (
        "read by its key, the transform lays the camera on its side, but its inverse does not: check whether it is "
        "inverted"
    )
    return (warning("CAL-404", camera, sentence),)


def _sized(node: Node, rows: int, columns: int) -> NDArray[np.float64]:
    """Return a matrix with its own size, or a list of its numbers; vectors may be rows or columns."""
    if isinstance(node.value, list):
        return node.matrix(rows, columns)
    declared = (node.at("rows").whole("rows"), node.at("cols").whole("columns"))
    if declared != (rows, columns) and not (1 in (rows, columns) and declared == (columns, rows)):
        raise node.at("rows").refused(f"{rows} x {columns} are expected and {declared[0]} x {declared[1]} declared")
    return node.at("data").matrix(rows, columns)


def _numbers(node: Node) -> NDArray[np.float64]:
    """Return a vector of any length, as its matrix declares it."""
    if isinstance(node.value, list):
        return node.vector()
    count = node.at("rows").whole("rows") * node.at("cols").whole("columns")
    numbers = node.at("data").vector()
    if len(numbers) != count:
        raise node.at("data").refused(f"{count} numbers are declared and {len(numbers)} given")
    return numbers
