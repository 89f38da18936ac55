"""One robot of known geometry, written in every format by scipy and numpy alone; whatever is read must be this robot.

**Conventions.** `EGO_FROM` are 4 × 4 matrices by frame. Cameras are optical frames; CAM_LEFT is tilted, so that no
axis can be swapped unseen. Quaternions of scipy are xyzw.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from stone.sensors.calibration import CameraIntrinsics

Matrix = NDArray[np.float64]

# What turns a link (x forward, z up) to its optical frame: fixed axes roll −90°, pitch 0, yaw −90° (REP 103).
LINK_FROM_OPTICAL = np.eye(4)
LINK_FROM_OPTICAL[:3, :3] = Rotation.from_euler("xyz", [-90, 0, -90], degrees=True).as_matrix()


def placed(xyz_m: tuple[float, float, float], rpy_deg: tuple[float, float, float]) -> Matrix:
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler("xyz", rpy_deg, degrees=True).as_matrix()
    matrix[:3, 3] = xyz_m
    return matrix


EGO_FROM: dict[str, Matrix] = {
    "hesai_lidar": placed((0.05, -0.02, 0.95), (1.0, -2.0, -89.0)),
    "camera_front": placed((0.31, 0.01, 0.80), (0.5, 3.0, -1.0)) @ LINK_FROM_OPTICAL,
    "camera_left": placed((0.10, 0.25, 0.75), (-2.0, 12.0, 85.0)) @ LINK_FROM_OPTICAL,
    "imu": placed((0.05, 0.02, 0.30), (180.0, 0.0, 90.0)),
}
CAMERAS = {"CAM_FRONT": "camera_front", "CAM_LEFT": "camera_left"}
LENSES = {
    "camera_front": CameraIntrinsics(
        "plumb_bob", 1920, 1200, 1179.4, 1178.9, 983.9, 596.7, (-0.22, 0.07, 1e-4, -2e-4, 0)
    ),
    "camera_left": CameraIntrinsics(
        "equidistant", 960, 800, 606.5, 606.7, 474.9, 402.2, (-0.01, -0.006, 0.007, -0.004)
    ),
}
SHIFT_S = -0.0125


def relative(dst: str, src: str) -> Matrix:
    """`dst_from_src`."""
    return np.linalg.inv(EGO_FROM[dst]) @ EGO_FROM[src]


def write(folder: Path, files: Mapping[str, object]) -> Path:
    """Every file as JSON, which YAML is too; texts as they are."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        (folder / name).write_text(content if isinstance(content, str) else json.dumps(content, indent=1))
    return folder


def camera_matrix(lens: CameraIntrinsics) -> list[list[float]]:
    return [[lens.fx_px, 0, lens.cx_px], [0, lens.fy_px, lens.cy_px], [0, 0, 1]]


def camera_info(frame: str) -> dict[str, Any]:
    lens = LENSES[frame]
    numbers = [number for row in camera_matrix(lens) for number in row]
    return {
        "image_width": lens.width_px,
        "image_height": lens.height_px,
        "camera_name": frame,
        "camera_matrix": {"rows": 3, "cols": 3, "data": numbers},
        "distortion_model": lens.model,
        "distortion_coefficients": {"rows": 1, "cols": len(lens.distortion), "data": list(lens.distortion)},
    }


def ros_matrices() -> dict[str, object]:
    """camera_info files, and the frames as `T_base_link__frame` with numbers in texts, as ROS 1 tools write them."""
    frames = {
        f"T_base_link__{frame}": {"rows": 4, "cols": 4, "data": [repr(float(value)) for value in matrix.ravel()]}
        for frame, matrix in EGO_FROM.items()
    }
    return {"frames.yaml": frames, **{f"{frame}.yaml": camera_info(frame) for frame in LENSES}}


def tf_text(frames: Mapping[tuple[str, str], Matrix]) -> str:
    """As `ros2 topic echo /tf_static` prints it, a document for each message."""
    return "".join(f"{_stamped(*pair, matrix)}---\n" for pair, matrix in frames.items())


def _stamped(parent: str, child: str, matrix: Matrix) -> str:
    x, y, z, w = Rotation.from_matrix(matrix[:3, :3]).as_quat().tolist()
    at = dict(zip("xyz", matrix[:3, 3].tolist(), strict=True))
    return (
        "transforms:\n- header:\n    stamp:\n      sec: 0\n      nanosec: 0\n"
        f"    frame_id: {parent}\n  child_frame_id: {child}\n  transform:\n"
        f"    translation: {json.dumps(at)}\n    rotation: {json.dumps({'x': x, 'y': y, 'z': z, 'w': w})}\n"
    )


def ros_tf() -> dict[str, object]:
    """camera_info files beside a tree: the cameras hang on their links, their optical frames on those."""
    frames = {
        ("base_link", "hesai_lidar"): EGO_FROM["hesai_lidar"],
        ("hesai_lidar", "imu"): relative("hesai_lidar", "imu"),
    }
    for frame in LENSES:
        frames["hesai_lidar", f"{frame}_link"] = relative("hesai_lidar", frame) @ np.linalg.inv(LINK_FROM_OPTICAL)
        frames[f"{frame}_link", f"{frame}_optical_frame"] = LINK_FROM_OPTICAL
    return {"tf.yaml": tf_text(frames), **{f"{frame}.yaml": camera_info(frame) for frame in LENSES}}


def kalibr() -> dict[str, object]:
    """A camchain-imucam of two cameras, and the rig document that knows the rest; its other results lie beside it."""
    chain = {}
    for number, frame in enumerate(LENSES):
        lens = LENSES[frame]
        chain[f"cam{number}"] = {
            "T_cam_imu": relative(frame, "imu").tolist(),
            "camera_model": "pinhole",
            "intrinsics": [lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px],
            "distortion_model": "radtan" if lens.model == "plumb_bob" else lens.model,
            "distortion_coeffs": list(lens.distortion[:4]),
            "resolution": [lens.width_px, lens.height_px],
            "timeshift_cam_imu": SHIFT_S,
        }
    chain["cam1"]["T_cn_cnm1"] = relative("camera_left", "camera_front").tolist()
    transforms = [
        {"parent": "base_link", "child": "hesai_lidar", "matrix": EGO_FROM["hesai_lidar"].tolist()},
        {"parent": "imu0", "child": "hesai_lidar", "matrix": relative("imu", "hesai_lidar").tolist()},
    ]
    sensors = {channel: {"frame": f"cam{number}"} for number, channel in enumerate(CAMERAS)}
    rig = {"stone_rig": 1, "transforms": transforms, "sensors": sensors}
    return {"camchain.yaml": chain, "imu.yaml": {"imu0": {"rostopic": "/imu"}}, "rig.yaml": rig, "report.txt": "fine"}


def opencalib() -> dict[str, object]:
    """A file for each pair and each lens; only plumb_bob is known to it."""
    files: dict[str, object] = {"lidar-to-car.json": _pair("hesai_lidar", "car_center", EGO_FROM["hesai_lidar"])}
    for frame, lens in LENSES.items():
        files[f"lidar-to-{frame}.json"] = _pair("hesai_lidar", frame, relative(frame, "hesai_lidar"))
        parameters = {
            "img_dist_w": lens.width_px,
            "img_dist_h": lens.height_px,
            "cam_K": {"rows": 3, "cols": 3, "data": camera_matrix(lens)},
            "cam_dist": {"rows": 1, "cols": 4, "data": [list(lens.distortion[:4])]},
        }
        entry = {"sensor_name": frame, "target_sensor_name": frame, "param_type": "intrinsic", "param": parameters}
        files[f"{frame}.json"] = {f"{frame}-intrinsic": entry}
    return files


def _pair(sensor: str, target: str, target_from_sensor: Matrix) -> dict[str, object]:
    calib = {"rows": 4, "cols": 4, "data": target_from_sensor.tolist()}
    entry = {"sensor_name": sensor, "target_sensor_name": target, "param_type": "extrinsic"}
    return {f"{sensor}-to-{target}-extrinsic": {**entry, "param": {"time_lag": 0, "sensor_calib": calib}}}


def nuscenes() -> dict[str, object]:
    """Both tables, and a rig document for what they never say: the images' sizes."""
    channels = {"LIDAR_TOP": "hesai_lidar", **CAMERAS}
    rows, sensors = [], []
    for channel, frame in channels.items():
        quaternion = np.roll(Rotation.from_matrix(EGO_FROM[frame][:3, :3]).as_quat(), 1).tolist()
        intrinsic = camera_matrix(LENSES[frame]) if frame in LENSES else []
        place = {"translation": EGO_FROM[frame][:3, 3].tolist(), "rotation": quaternion}
        rows.append({"token": f"c{channel}", "sensor_token": f"s{channel}", **place, "camera_intrinsic": intrinsic})
        sensors.append({"token": f"s{channel}", "channel": channel, "modality": "camera" if intrinsic else "lidar"})
    sizes = {
        channel: {"frame": channel, "width_px": LENSES[frame].width_px, "height_px": LENSES[frame].height_px}
        for channel, frame in CAMERAS.items()
    }
    return {"calibrated_sensor.json": rows, "sensor.json": sensors, "rig.yaml": {"stone_rig": 1, "sensors": sizes}}


def autoware() -> dict[str, object]:
    """A kit on the base and sensors on the kit, cameras as links; lenses as camera_info."""
    base_from_kit = placed((0.0, 0.0, 0.7), (0.0, 1.0, 3.0))
    links = {"velodyne_top_base_link": EGO_FROM["hesai_lidar"], "tamagawa/imu_link": EGO_FROM["imu"]}
    for frame in LENSES:
        links[f"{frame}/camera_link"] = EGO_FROM[frame] @ np.linalg.inv(LINK_FROM_OPTICAL)
    kit = {link: _six(np.linalg.inv(base_from_kit) @ matrix) for link, matrix in links.items()}
    return {
        "sensor_kit_calibration.yaml": {"sensor_kit_base_link": kit},
        "sensors_calibration.yaml": {"base_link": {"sensor_kit_base_link": _six(base_from_kit)}},
        **{f"{frame}.yaml": camera_info(frame) for frame in LENSES},
    }


def _six(matrix: Matrix) -> dict[str, float]:
    """x y z roll pitch yaw, angles about fixed axes."""
    angles = Rotation.from_matrix(matrix[:3, :3]).as_euler("xyz").tolist()
    return dict(zip(("x", "y", "z", "roll", "pitch", "yaw"), [*matrix[:3, 3].tolist(), *angles], strict=True))


def rellis() -> dict[str, object]:
    """Each camera in the LiDAR's frame by quaternion and translation; lenses as camera_info."""
    placed_at = {}
    for frame in LENSES:
        matrix = relative("hesai_lidar", frame)
        quaternion = dict(zip("xyzw", Rotation.from_matrix(matrix[:3, :3]).as_quat().tolist(), strict=True))
        place = dict(zip("xyz", matrix[:3, 3].tolist(), strict=True))
        placed_at[f"hesai_lidar-{frame}"] = {"q": quaternion, "t": place}
    base = {"parent": "base_link", "child": "hesai_lidar", "matrix": EGO_FROM["hesai_lidar"].tolist()}
    return {
        "transforms.yaml": placed_at,
        "rig.yaml": {"stone_rig": 1, "transforms": [base]},
        **{f"{frame}.yaml": camera_info(frame) for frame in LENSES},
    }


def opencv() -> dict[str, object]:
    """A file of FileStorage's for each camera: its lens, and where the LiDAR's points are to it."""
    base = {"parent": "base_link", "child": "lidar", "matrix": EGO_FROM["hesai_lidar"].tolist()}
    files: dict[str, object] = {"rig.yaml": {"stone_rig": 1, "transforms": [base]}}
    for frame, lens in LENSES.items():
        matrix = relative(frame, "hesai_lidar")
        head = f"%YAML:1.0\n---\nimage_width: {lens.width_px}\nimage_height: {lens.height_px}\n"
        head += "fisheye_model: 1\n" if lens.model == "equidistant" else ""
        files[f"{frame}.yml"] = head + "".join(
            opencv_matrix(key, value)
            for key, value in {
                "camera_matrix": np.array(camera_matrix(lens)),
                "distortion_coefficients": np.array(lens.distortion)[:, None],
                "R": matrix[:3, :3],
                "T": matrix[:3, 3:],
            }.items()
        )
    return files


def opencv_matrix(key: str, matrix: Matrix) -> str:
    """As FileStorage writes one."""
    numbers = ", ".join(f"{value:.17g}".replace("nan", ".Nan") for value in matrix.ravel().tolist())
    rows, columns = matrix.shape
    return f"{key}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n   data: [ {numbers} ]\n"


def stereo() -> dict[str, object]:
    """A stereo pair as Nerian writes it, without tags."""
    pair = {f"M{number}": np.array(camera_matrix(lens)).ravel().tolist() for number, lens in _numbered()}
    pair |= {f"D{number}": list(lens.distortion) for number, lens in _numbered()}
    second_from_first = relative("camera_left", "camera_front")
    pair |= {"R": second_from_first[:3, :3].ravel().tolist(), "T": second_from_first[:3, 3].tolist()}
    transforms = [
        {"parent": "base_link", "child": "hesai_lidar", "matrix": EGO_FROM["hesai_lidar"].tolist()},
        {"parent": "hesai_lidar", "child": "camera_left", "matrix": relative("hesai_lidar", "camera_front").tolist()},
    ]
    return {"stereo.yaml": {**pair, "size": [1920, 1200]}, "rig.yaml": {"stone_rig": 1, "transforms": transforms}}


def _numbered() -> list[tuple[int, CameraIntrinsics]]:
    return list(enumerate(LENSES.values(), start=1))


def kitti() -> dict[str, object]:
    """An object file: two rectified cameras side by side, the scanner and the IMU; and the ground under the car."""
    forward = np.linalg.inv(EGO_FROM["camera_front"]) @ EGO_FROM["hesai_lidar"]
    rectifying = Rotation.from_euler("xyz", [0.4, -0.3, 0.2], degrees=True).as_matrix()
    projection = np.array([[721.5, 0.0, 609.6, 44.9], [0.0, 721.5, 172.9, 0.2], [0.0, 0.0, 1.0, 0.003]])
    beside = projection.copy()
    beside[0, 3] -= 721.5 * 0.54
    texts = {
        "P2": projection,
        "P3": beside,
        "R0_rect": rectifying,
        "Tr_velo_to_cam": forward[:3],
        "Tr_imu_to_velo": relative("hesai_lidar", "imu")[:3],
    }
    base = {"parent": "base_link", "child": "velodyne", "matrix": EGO_FROM["hesai_lidar"].tolist()}
    sizes = {f"CAM_{side}": {"frame": f"cam{number}", "width_px": 1242, "height_px": 375} for number, side in SIDES}
    return {
        "000000.txt": {key: " ".join(f"{value:.15e}" for value in matrix.ravel()) for key, matrix in texts.items()},
        "rig.yaml": {"stone_rig": 1, "transforms": [base], "sensors": sizes},
    }


SIDES = ((2, "LEFT"), (3, "RIGHT"))


def kitti_text(lines: Mapping[str, str]) -> str:
    return "".join(f"{key}: {numbers}\n" for key, numbers in lines.items())
