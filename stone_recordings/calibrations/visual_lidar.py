"""direct_visual_lidar_calibration (koide3): calib.json of a LiDAR and a camera.

**Conventions.** `results.T_lidar_camera` is [x, y, z, qx, qy, qz, qw] and maps camera to LiDAR coordinates
(`p_lidar = T_lidar_camera * p_camera`), z forward in the camera. Without it the initial guesses are no calibration.
`intrinsics` are fx, fy, cx, cy; `fisheye` is OpenCV's, ROS's equidistant. The size of images is not in the file.
Source: koide3/direct_visual_lidar_calibration, its page "Programs" and src/calibrate.cpp.
"""

import numpy as np

from stone.sensors.calibration_checks import quaternion_and_translation
from stone_recordings.calibrations.errors import half_rig, unread_lens_model
from stone_recordings.calibrations.part import CalibrationPart, Edge, LensText, Node, intrinsics

LIDAR, CAMERA = "lidar", "camera"
MODELS = ("plumb_bob", "fisheye")


def is_visual_lidar(content: dict[str, object]) -> bool:
    results, camera = content.get("results"), content.get("camera")
    has_result = isinstance(results, dict) and any("T_lidar_camera" in str(key) for key in results)
    return has_result or (isinstance(camera, dict) and "distortion_coeffs" in camera and "camera_model" in camera)


def visual_lidar(document: Node) -> CalibrationPart:
    """Return the camera, its lens without a size, and its pose on the LiDAR. Raises `CAL-424`, `CAL-427`."""
    results = document.at("results") if document.has("results") else None
    if results is None or not results.has("T_lidar_camera"):
        missing = "it has no T_lidar_camera (the initial guess alone?)"
        raise half_rig(document.file, missing, "run `ros2 run direct_visual_lidar_calibration calibrate` first")
    numbers = results.at("T_lidar_camera").vector()
    if numbers.shape != (7,):
        raise results.at("T_lidar_camera").refused("seven numbers x, y, z, qx, qy, qz, qw are expected")
    lidar_from_camera, findings = quaternion_and_translation(CAMERA, "camera", numbers[[6, 3, 4, 5]], numbers[:3])
    camera = document.at("camera")
    model, matrix = camera.at("camera_model").text(), camera.at("intrinsics").vector()
    if model not in MODELS:
        raise unread_lens_model(document.file, CAMERA, model)
    if matrix.shape != (4,):
        raise camera.at("intrinsics").refused("four numbers fx, fy, cx, cy are expected")
    fx, fy, cx, cy = matrix.tolist()
    distortion = tuple(camera.at("distortion_coeffs").vector().tolist())
    lens = intrinsics(
        LensText(document.file, CAMERA, model, distortion), np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), (0, 0)
    )
    return CalibrationPart(
        document.file, "visual_lidar", (Edge(LIDAR, CAMERA, lidar_from_camera),), {CAMERA: lens},
        optical=frozenset({CAMERA}), findings=findings,
    )  # fmt: skip
