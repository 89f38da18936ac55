"""Parameter files of LiDAR-inertial odometry: FAST-LIO, Point-LIO, FAST-LIVO2 with its camera, LIO-SAM.

**Conventions.** Frames are called imu, lidar and camera. Only the parameters of the first node of a ROS 2 file are
read.

- FAST-LIO, Point-LIO (`mapping`) and FAST-LIVO2 (`extrin_calib`): `extrinsic_T`, `extrinsic_R` are the LiDAR's pose in
  the IMU's frame, `imu_from_lidar`;
- FAST-LIVO2: `Rcl`, `Pcl` are `camera_from_lidar`; camera_*.yaml gives the lens at the size `cam_width` × `cam_height`
  (`scale` shrinks both alike when the package runs, so it is ignored);
- LIO-SAM: `extrinsicRot` turns the IMU's measurements into the LiDAR's axes, `extrinsicTrans` is the IMU's position in
  them: `lidar_from_imu`, though a comment of its file calls it `T_lb (lidar -> imu)`. `extrinsicRPY` turns attitudes
  alone and is ignored.

Source: hku-mars/FAST_LIO, README.md ("the LiDAR's pose … in IMU body frame"); hku-mars/FAST-LIVO2, src/vio.cpp (`Rci =
Rcl * Rli`), config/; TixiaoShan/LIO-SAM, include/utility.h (`acc = extRot * acc`), src/imuPreintegration.cpp
(`lidarPose.compose(lidar2Imu)`), README.md (KITTI's calib_imu_to_velo).
"""

from collections.abc import Iterator

import numpy as np

from stone.geometry.se3 import SE3
from stone.sensors.calibration import SensorKind
from stone.sensors.calibration_checks import Findings, rotation_and_translation
from stone_recordings.calibrations.errors import unread_lens_model
from stone_recordings.calibrations.part import CalibrationPart, Edge, Format, LensText, Node, intrinsics

IMU, LIDAR, CAMERA = "imu", "lidar", "camera"
ROS2 = "ros__parameters"
GROUPS = ("mapping", "extrin_calib", "common", "lio_sam")
LIO_SAM = ("extrinsicTrans", "extrinsicRot")
KINDS: dict[str, SensorKind] = {IMU: "imu", LIDAR: "lidar", CAMERA: "camera"}
# The models of FAST-LIVO2's cameras, and the keys of their coefficients.
LENSES = {
    "Pinhole": ("plumb_bob", ("cam_d0", "cam_d1", "cam_d2", "cam_d3", "cam_d4")),
    "EquidistantCamera": ("equidistant", ("k1", "k2", "k3", "k4")),
}


def is_odometry(content: dict[str, object]) -> bool:
    groups = list(_groups(Node("", "", content)))
    return any(group.has(key) for group in groups for key in ("extrinsic_T", "Rcl", *LIO_SAM))


def is_odometry_camera(content: dict[str, object]) -> bool:
    return any(group.has("cam_model") for group in _groups(Node("", "", content)))


def odometry(document: Node) -> CalibrationPart:
    """Return the extrinsics of LiDAR, IMU and camera that the file has."""
    edges, findings, form = list[Edge](), Findings(), "fast_lio"
    for group in _groups(document):
        for parent, child, keys in (
            (IMU, LIDAR, ("extrinsic_R", "extrinsic_T")),
            (CAMERA, LIDAR, ("Rcl", "Pcl")),
            (LIDAR, IMU, LIO_SAM[::-1]),
        ):
            if group.has(keys[0]) or group.has(keys[1]):
                transform, noticed = _transform(group, child, keys)
                edges.append(Edge(parent, child, transform))
                findings += noticed
        form = "lio_sam" if group.has(LIO_SAM[0]) else "fast_livo2" if group.has("Rcl") else form
    kinds = {frame: KINDS[frame] for edge in edges for frame in (edge.parent, edge.child)}
    format_name: Format = "lio_sam" if form == "lio_sam" else "fast_livo2" if form == "fast_livo2" else "fast_lio"
    return CalibrationPart(
        document.file, format_name, tuple(edges), kinds=kinds, optical=frozenset({CAMERA}), findings=findings
    )


def odometry_camera(document: Node) -> CalibrationPart:
    """Return the lens of FAST-LIVO2's camera. Raises `CAL-427`."""
    camera = next(group for group in _groups(document) if group.has("cam_model"))
    name = camera.at("cam_model").text()
    if name not in LENSES:
        raise unread_lens_model(document.file, CAMERA, name)
    model, keys = LENSES[name]
    distortion = tuple(camera.at(key).number() if camera.has(key) else 0.0 for key in keys)
    fx, fy, cx, cy = (camera.at(f"cam_{key}").number() for key in ("fx", "fy", "cx", "cy"))
    size_px = (camera.at("cam_width").whole(), camera.at("cam_height").whole())
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    lens = intrinsics(LensText(document.file, CAMERA, model, distortion), matrix, size_px)
    return CalibrationPart(document.file, "fast_livo2", lenses={CAMERA: lens}, optical=frozenset({CAMERA}))


def _groups(document: Node) -> Iterator[Node]:
    """Yield the mappings with the packages' parameters: the file, its ROS 2 node's, and their groups."""
    nodes = [document]
    if isinstance(document.value, dict):
        inner = (entry for entry in document.entries().values() if entry.has(ROS2))
        nodes += [entry.at(ROS2) for entry in inner][:1]
    for node in nodes:
        yield node
        for key in GROUPS:
            if node.has(key) and isinstance(node.at(key).value, dict):
                yield node.at(key)
        yield from _dotted(node)


def _dotted(node: Node) -> Iterator[Node]:
    """Yield groups that ROS 2 files may also write as `extrin_calib.extrinsic_T`."""
    if not isinstance(node.value, dict):
        return
    for group in GROUPS:
        entries = {
            str(key).removeprefix(f"{group}."): value
            for key, value in node.value.items()
            if str(key).startswith(f"{group}.")
        }
        if entries:
            yield Node(node.file, f"{node.key}.{group}".lstrip("."), entries)


def _transform(group: Node, sensor: str, keys: tuple[str, str]) -> tuple[SE3, Findings]:
    rotation, position = (group.at(key) for key in keys)
    translation_m = position.vector()
    if translation_m.shape != (3,):
        raise position.refused("three numbers are expected, metres")
    return rotation_and_translation(sensor, rotation.matrix(3, 3), translation_m)
