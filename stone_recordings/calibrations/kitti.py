"""KITTI: calib text files of object, tracking, odometry and raw, and of data sets in its format (View-of-Delft).

**Conventions.** Lines are `key: numbers`, matrices by rows, metres. `Tr_velo_to_cam` (tracking: `Tr_velo_cam`) is
`reference_from_velodyne`, `R0_rect` (`R_rect`) is `rectified_from_reference`. `Tr` of odometry is
`rectified_from_velodyne`, `Tr_imu_to_velo` is `velodyne_from_imu`. A point of the scanner is at `P_i R0_rect
Tr_velo_to_cam x` in image i. P_i = K [I | t] is of rectified images: the lens is K without distortion, and camera i is
`cam_i_from_rectified` = t. If all P_i are equal (View-of-Delft) there is one camera, cam2. Raw: `calib_velo_to_cam.txt`
and `calib_imu_to_velo.txt` have R and T in the same directions. `calib_cam_to_cam.txt` gives `P_rect_0i`, `R_rect_00`
and `S_rect_0i`, the size of the rectified images (synced data, as recorded by kitti2bag; the unrectified ones need K
and D by camera_info). The other files contain no size: a rig.yaml does. View-of-Delft writes its radar's file with the
LiDAR's key, `Tr_velo_to_cam`, and only the folder distinguishes them: in a folder `radar` it is the radar's. None
contains the vehicle's position on the ground. Source: Geiger et al., IJRR 2013, eq. 3–8; readme.txt of the object and
odometry devkits; View-of-Delft's docs.
"""

import re
from pathlib import PurePath

import numpy as np
from numpy.typing import NDArray

from stone.sensors.calibration import CameraIntrinsics, SensorKind
from stone.sensors.calibration_checks import Findings, rotation_and_translation
from stone_recordings.calibrations.draft import words_of
from stone_recordings.calibrations.errors import half_rig
from stone_recordings.calibrations.part import CalibrationPart, Edge, LensText, Node, intrinsics

REFERENCE, RECTIFIED, LIDAR, IMU, RADAR = "reference", "rectified", "velodyne", "imu", "radar"
MAIN_CAMERA = "cam2"
PROJECTION = re.compile(r"P(\d)|P_rect_0(\d)")
# Each key that places one frame in another, in all its spellings: parent, child.
TRANSFORMS = {
    "Tr": (RECTIFIED, LIDAR),
    "Tr_velo_to_cam": (REFERENCE, LIDAR),
    "Tr_velo_cam": (REFERENCE, LIDAR),
    "Tr_imu_to_velo": (LIDAR, IMU),
    "Tr_imu_velo": (LIDAR, IMU),
}
RECTIFYING = ("R0_rect", "R_rect", "R_rect_00")
# The raw files of one transform have the same keys except these, and their names.
OF_VELO_TO_CAM = ("delta_f", "delta_c")


def is_kitti(content: dict[str, object]) -> bool:
    """Return whether these are matrices as texts of numbers under KITTI's keys."""
    texts = {key for key, value in content.items() if isinstance(value, str)}
    is_raw = "calib_time" in content and {"R", "T"} <= texts
    return is_raw or any(key in TRANSFORMS or PROJECTION.fullmatch(key) for key in texts)


def kitti(document: Node) -> CalibrationPart:
    """Return the calibration of one file. Raises `CAL-424` for a raw R and T whose frames the file does not name."""
    edges, findings = list[Edge](), Findings()
    for parent, child, numbers in _transforms(document):
        transform, noticed = rotation_and_translation(child, numbers[:, :3], numbers[:, 3])
        edges.append(Edge(parent, child, transform))
        findings += noticed
    for key in RECTIFYING:
        if document.has(key):
            turn, noticed = rotation_and_translation(key, _matrix(document.at(key), 3, 3), np.zeros(3))
            edges.append(Edge(RECTIFIED, REFERENCE, turn))
            findings += noticed
    lenses = dict[str, CameraIntrinsics]()
    for camera, matrix in _projections(document).items():
        lenses[camera], shift_m = _camera(document, camera, matrix)
        shift, noticed = rotation_and_translation(camera, np.eye(3), shift_m)
        edges.append(Edge(camera, RECTIFIED, shift))
        findings += noticed
    frames = {frame for edge in edges for frame in (edge.parent, edge.child)}
    kinds: dict[str, SensorKind] = {LIDAR: "lidar", RADAR: "radar", IMU: "imu"}
    present = {frame: kind for frame, kind in kinds.items() if frame in frames}
    return CalibrationPart(document.file, "kitti", tuple(edges), lenses, {}, present, frozenset(lenses), findings)


def _transforms(document: Node) -> list[tuple[str, str, NDArray[np.float64]]]:
    """Return (parent, child, (3, 4)) of every transform that is filled in: View-of-Delft leaves `Tr_imu_to_velo`
    empty.
    """
    scanner = RADAR if RADAR in words_of(PurePath(document.file).parent.as_posix()) else LIDAR
    given = [(document.at(key), pair) for key, pair in TRANSFORMS.items() if document.has(key)]
    transforms = [
        (parent, scanner if child == LIDAR else child, _matrix(node, 3, 4))
        for node, (parent, child) in given
        if node.value is not None
    ]
    if document.has("R") and document.has("T"):
        rotation, translation_m = _matrix(document.at("R"), 3, 3), _matrix(document.at("T"), 3, 1)
        transforms.append((*_raw_pair(document), np.hstack([rotation, translation_m])))
    return transforms


def _raw_pair(document: Node) -> tuple[str, str]:
    name = PurePath(document.file).stem
    if any(document.has(key) for key in OF_VELO_TO_CAM) or name.endswith("velo_to_cam"):
        return REFERENCE, LIDAR
    if name.endswith("imu_to_velo"):
        return LIDAR, IMU
    missing = "the frames of its R and T are unknown"
    raise half_rig(document.file, missing, "keep KITTI's file name, calib_imu_to_velo.txt or the like")


def _projections(document: Node) -> dict[str, NDArray[np.float64]]:
    """Return (3, 4) by camera, without identities, which stand for none; the main camera alone if all are equal."""
    named = [(PROJECTION.fullmatch(key), node) for key, node in document.entries().items()]
    given = {f"cam{match[1] or match[2]}": _matrix(node, 3, 4) for match, node in named if match}
    cameras = {camera: matrix for camera, matrix in given.items() if not np.array_equal(matrix[:, :3], np.eye(3))}
    if MAIN_CAMERA in cameras and all(np.array_equal(matrix, cameras[MAIN_CAMERA]) for matrix in cameras.values()):
        return {MAIN_CAMERA: cameras[MAIN_CAMERA]}
    return cameras


def _camera(document: Node, camera: str, matrix: NDArray[np.float64]) -> tuple[CameraIntrinsics, NDArray[np.float64]]:
    """Return the lens, and the origin of the rectified frame in the camera (3,), metres."""
    size_key = f"S_rect_0{camera.removeprefix('cam')}"
    width_px, height_px = _size_px(document.at(size_key)) if document.has(size_key) else (0, 0)
    lens = intrinsics(LensText(document.file, camera, "none", ()), matrix[:, :3], (width_px, height_px))
    if not (lens.fx_px and lens.fy_px):
        raise Node(document.file, camera, matrix.tolist()).refused("a projection with focal lengths is expected")
    with np.errstate(over="ignore", invalid="ignore"):
        shift_m: NDArray[np.float64] = np.linalg.inv(matrix[:, :3]) @ matrix[:, 3]
    return lens, shift_m


def _size_px(node: Node) -> tuple[int, int]:
    sides = node.words()
    if len(sides) != 2:
        raise node.refused("width and height are expected")
    return sides[0].whole(), sides[1].whole()


def _matrix(node: Node, rows: int, columns: int) -> NDArray[np.float64]:
    """Return the numbers of a line, by rows."""
    words = node.words()
    if len(words) != rows * columns:
        raise node.refused(f"{rows} x {columns} numbers by rows are expected and {len(words)} given")
    return np.array([word.number() for word in words]).reshape(rows, columns)
