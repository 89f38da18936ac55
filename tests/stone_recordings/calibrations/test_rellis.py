"""KITTI's text files land where its equation puts every point; RELLIS-3D's labelled points on pixels of their class."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scipy.spatial import cKDTree

from stone.errors import StoneError
from stone.geometry.se3 import SE3
from stone.sensors.calibration import Calibration, CameraIntrinsics, Mount
from stone.sensors.projection import project
from stone_recordings.calibrations.file import CalibrationRead, read_any_calibration
from testing.refusals import refused_as
from tests.stone_recordings.calibrations import robots

POINTS = np.random.default_rng(5).uniform((4.0, -3.0, -1.0), (30.0, 3.0, 1.0), (200, 3)) @ np.array(
    [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
)  # before the camera, in the frame of a scanner whose y points forward


def lines() -> dict[str, str]:
    return dict(robots.kitti()["000000.txt"])  # type: ignore[call-overload]


def written(folder: Path, files: dict[str, dict[str, str]], sizes: bool = True) -> Path:
    rig: Any = robots.kitti()["rig.yaml"]
    texts = {name: robots.kitti_text(content) for name, content in files.items()}
    if not sizes:
        rig["sensors"] = {channel: {"frame": sensor["frame"]} for channel, sensor in rig["sensors"].items()}
    for name in files:
        (folder / "car" / name).parent.mkdir(parents=True, exist_ok=True)
    return robots.write(folder / "car", {**texts, "rig.yaml": rig})


def matrix(text: str, columns: int) -> np.ndarray:
    return np.array(text.split(), np.float64).reshape(-1, columns)


def by_the_equation(camera: str) -> np.ndarray:
    """x = P R0 Tr X, pixels (N, 2)."""
    found = lines()
    rectifying, transform = np.eye(4), np.eye(4)
    rectifying[:3, :3] = matrix(found["R0_rect"], 3)
    transform[:3] = matrix(found["Tr_velo_to_cam"], 4)
    homogeneous = np.c_[POINTS, np.ones(len(POINTS))]
    image = homogeneous @ (matrix(found[camera], 4) @ rectifying @ transform).T
    return image[:, :2] / image[:, 2:]


def by_us(calibration: Calibration, channel: str) -> np.ndarray:
    mount = calibration.mount(channel)
    assert mount is not None
    assert isinstance(mount.intrinsics, CameraIntrinsics)
    return project(mount.lidar_from_sensor.inverse() @ POINTS, mount.intrinsics)[0]


def check(folder: Path) -> Calibration:
    read = read_any_calibration(folder)
    assert read.format == "kitti"
    for number, side in robots.SIDES:
        np.testing.assert_allclose(by_us(read.calibration, f"CAM_{side}"), by_the_equation(f"P{number}"), atol=1e-6)
    np.testing.assert_allclose(read.calibration.ego_from_lidar.as_matrix(), robots.EGO_FROM["hesai_lidar"], atol=1e-9)
    return read.calibration


def test_an_object_file_projects_as_its_equation_says_and_odometry_at_once(tmp_path: Path) -> None:
    found = check(written(tmp_path, {"000000.txt": lines()}))
    imu = found.mount("IMU")
    assert imu is not None
    np.testing.assert_allclose(imu.lidar_from_sensor.as_matrix(), robots.relative("hesai_lidar", "imu"), atol=1e-9)
    found = lines()
    rectifying, transform = matrix(found.pop("R0_rect"), 3), matrix(found.pop("Tr_velo_to_cam"), 4)
    found["Tr"] = " ".join(f"{value:.15e}" for value in (rectifying @ transform).ravel())
    check(written(tmp_path, {"calib.txt": found}))


def test_a_tracking_file_with_its_missing_colons_says_the_same(tmp_path: Path) -> None:
    names = {"R0_rect": "R_rect", "Tr_velo_to_cam": "Tr_velo_cam", "Tr_imu_to_velo": "Tr_imu_velo"}
    folder = written(tmp_path, {"0000.txt": lines()})
    text = (folder / "0000.txt").read_text()
    for key, name in names.items():
        text = text.replace(f"{key}: ", f"{name} ")
    (folder / "0000.txt").write_text(text)
    assert "R_rect " in text
    check(folder)


def test_the_three_files_of_a_raw_day_say_the_same_and_the_size(tmp_path: Path) -> None:
    object_file = lines()
    date, sizes = {"calib_time": "09-Jan-2012 13:57:47"}, {f"S_rect_0{number}": "1.242000e+03 375" for number in (2, 3)}

    def parts(key: str) -> dict[str, str]:
        both = matrix(object_file[key], 4)
        return {"R": " ".join(map(repr, both[:, :3].ravel().tolist())), "T": " ".join(map(repr, both[:, 3].tolist()))}

    files = {
        "calib_velo_to_cam.txt": date | parts("Tr_velo_to_cam") | {"delta_f": "0 0", "delta_c": "0 0"},
        "calib_imu_to_velo.txt": date | parts("Tr_imu_to_velo"),
        "calib_cam_to_cam.txt": date
        | {"corner_dist": "9.950000e-02", "K_02": "1 0 0 0 1 0 0 0 1", "D_02": "0 0 0 0 0"}
        | {"R_rect_00": object_file["R0_rect"], "P_rect_02": object_file["P2"], "P_rect_03": object_file["P3"]}
        | sizes,
    }
    found = check(written(tmp_path, files, sizes=False))
    assert [mount.name for mount in found.mounts] == ["CAM_LEFT", "CAM_RIGHT", "IMU"]


def test_a_transform_that_lost_its_frames_is_refused(tmp_path: Path) -> None:
    numbers = {"calib_time": "now", "R": "1 0 0 0 1 0 0 0 1", "T": "0 0 1"}
    with refused_as("CAL-424"):
        read_any_calibration(written(tmp_path, {"000000.txt": lines(), "calib.txt": numbers}))
    files = robots.rellis()
    placed = files["transforms.yaml"]
    assert isinstance(placed, dict)
    files["transforms.yaml"] = {"hesai_lidar": placed["hesai_lidar-camera_front"]}
    with refused_as("CAL-422"):
        read_any_calibration(robots.write(tmp_path / "mule", files))


def test_the_radar_of_view_of_delft_is_told_by_its_folder(tmp_path: Path) -> None:
    both = {key: lines()["P2"] for key in ("P0", "P1", "P2", "P3")} | {"R0_rect": "1 0 0 0 1 0 0 0 1"}
    scanner = robots.relative("camera_front", "hesai_lidar")
    radar = scanner.copy()
    radar[:3, 3] += (0.0, 0.5, 2.0)
    empty = {"Tr_imu_to_velo": ""}
    files = {
        f"{name}/training/calib/00549.txt": both
        | {"Tr_velo_to_cam": " ".join(map(repr, pose[:3].ravel().tolist()))}
        | empty
        for name, pose in (("lidar", scanner), ("radar", radar))
    }
    folder = written(tmp_path, files)
    rig: Any = robots.kitti()["rig.yaml"]
    rig["sensors"] = {}
    robots.write(folder, {"rig.yaml": rig})
    found = read_any_calibration(folder).calibration
    assert [(mount.name, mount.kind) for mount in found.mounts] == [("cam2", "camera"), ("radar", "radar")]
    np.testing.assert_allclose(found.mounts[1].lidar_from_sensor.as_matrix(), np.linalg.inv(scanner) @ radar, atol=1e-9)


@pytest.mark.parametrize(
    ("key", "value", "leaf"),
    [
        ("P2", "1 2 3", "CAL-422"),
        ("P2", "721 0 609 44 0 721 172 0 0 0 2 0", "CAL-422"),
        ("P2", "0 0 609 44 0 0 172 0 0 0 1 0", "CAL-422"),
        ("P2", "nan 0 609 44 0 721 172 0 0 0 1 0", "CAL-416"),
        ("P2", "721 0 609 nan 0 721 172 0 0 0 1 0", "CAL-416"),
        ("P2", "many 0 609 44 0 721 172 0 0 0 1 0", "CAL-422"),
        ("R0_rect", "1 0 0 0 1 0 0 0 -1", "CAL-408"),
        ("R0_rect", "", "CAL-422"),
        ("Tr_velo_to_cam", "1 0 0 0 0 1.1 0 0 0 0 1 0", "CAL-401"),
        ("Tr_velo_to_cam", "1 0 0 inf 0 1 0 0 0 0 1 0", "CAL-416"),
        ("Tr_velo_to_cam", "1 0 0 151 0 1 0 0 0 0 1 0", "CAL-409"),
        ("Tr_velo_to_cam", "7", "CAL-422"),
    ],
)
def test_a_wrong_line_is_refused_by_its_key(tmp_path: Path, key: str, value: str, leaf: str) -> None:
    with refused_as(leaf) as reason:
        read_any_calibration(written(tmp_path, {"000000.txt": lines() | {key: value}}))
    assert "\n" not in str(reason.value)


def test_a_text_as_long_as_a_disk_is_refused_and_another_text_left_aside(tmp_path: Path) -> None:
    folder = written(tmp_path, {"000000.txt": lines()})
    (folder / "notes.txt").write_text("P2 was measured by Ann\n" * 100_000)
    read = read_any_calibration(folder)
    assert [finding.code for finding in read.findings] == ["CAL-436", "CAL-431"]
    (folder / "000001.txt").write_text("P2: " + "1 " * 1_000_000)
    with refused_as("CAL-420"):
        read_any_calibration(folder)


@pytest.mark.field_data
def test_view_of_delfts_own_files_put_camera_and_radar_where_the_car_has_them(field_data: Path, tmp_path: Path) -> None:
    """The LiDAR is on the roof, the camera behind the windscreen before it, the radar behind the front bumper."""
    root = field_data / "calibrations" / "kitti"
    shutil.copytree(root, tmp_path / "car")
    base = {"parent": "base_link", "child": "velodyne", "translation_m": [0, 0, 1.8], "rotation_wxyz": [1, 0, 0, 0]}
    (tmp_path / "car").chmod(0o755)
    found = read_any_calibration(
        robots.write(tmp_path / "car", {"rig.yaml": {"stone_rig": 1, "transforms": [base]}})
    ).calibration
    camera, radar = found.mounts
    assert (camera.lidar_from_sensor.rotation() @ (0.0, 0.0, 1.0))[0] > 0.98
    assert camera.lidar_from_sensor.translation_m == pytest.approx((1.0, 0.1, -0.4), abs=0.2)
    assert (radar.lidar_from_sensor.rotation() @ (1.0, 0.0, 0.0))[0] > 0.98
    assert radar.lidar_from_sensor.translation_m == pytest.approx((2.5, 0.1, -1.2), abs=0.2)


RIG = """\
stone_rig: 1
lidar: os1_cloud_node
transforms:                            # the LiDAR's x points backward
  - {parent: base_link, child: os1_cloud_node, translation_m: [0, 0, 1.0], rotation_wxyz: [0, 0, 0, 1]}
sensors: {CAM_FRONT: {frame: pylon_camera_node, width_px: 1920, height_px: 1200}}
"""
SEEN_CLASSES = (3, 4, 19, 31)  # grass, tree, bush, puddle


@pytest.fixture
def example(field_data: Path) -> Path:
    folder = field_data / "rellis3d_example" / "example"
    if not folder.is_dir():
        pytest.skip("the RELLIS-3D example is not among the field data")
    return folder


@pytest.fixture
def read(example: Path, tmp_path: Path) -> CalibrationRead:
    for name in ("transforms.yaml", "vel2os1.yaml", "camera_info.txt"):
        shutil.copy(example / name, tmp_path / name)
    (tmp_path / "rig.yaml").write_text(RIG)
    return read_any_calibration(tmp_path)


def scan(path: Path) -> np.ndarray:
    return np.fromfile(path, np.float32).reshape(-1, 4)[:, :3].astype(np.float64)


def agreement(example: Path, lidar_from_camera: SE3, lens: CameraIntrinsics) -> tuple[int, float]:
    """How many labelled points are in the image, and the share of them that have the class of their pixel."""
    points = scan(example / "000104.bin")
    classes = np.fromfile(example / "000104.label", np.uint32) & 0xFFFF
    pixels, is_inside = project(lidar_from_camera.inverse() @ points, lens)
    is_inside &= np.isin(classes, SEEN_CLASSES) & (np.linalg.norm(points, axis=1) > 1.0)
    labelled = np.asarray(Image.open(example / "frame000104-1581624663_149.png"))
    columns, rows = pixels[is_inside].round().astype(int).T
    return len(rows), float((labelled[rows, columns] == classes[is_inside]).mean())


@pytest.mark.field_data
def test_points_land_on_pixels_of_their_class_and_the_other_way_round_they_do_not(example, read):
    assert read.format == "rellis"
    camera = read.calibration.mount("CAM_FRONT")
    assert isinstance(camera, Mount)
    assert camera.intrinsics == CameraIntrinsics(
        "pinhole", 1920, 1200, 2813.643275, 2808.326079, 969.285772, 624.049972
    )
    seen, agreeing = agreement(example, camera.lidar_from_sensor, camera.intrinsics)
    assert seen > 5000
    assert agreeing > 0.7
    assert agreement(example, camera.lidar_from_sensor.inverse(), camera.intrinsics)[0] < 10
    assert [(finding.code, finding.severity) for finding in read.findings] == [("CAL-426", "info"), ("CAL-436", "info")]


@pytest.mark.field_data
def test_the_other_lidar_sees_the_same_ground(example: Path, read: CalibrationRead) -> None:
    other = read.calibration.mount("vel_cloud_node")
    assert isinstance(other, Mount)
    near = cKDTree(scan(example / "000104.bin"))
    points = scan(example / "vel000104.bin")
    reach_m = np.linalg.norm(points, axis=1)
    points = points[(reach_m > 2.0) & (reach_m < 20.0)]
    apart_m = [
        float(np.median(near.query(pose @ points)[0]))
        for pose in (other.lidar_from_sensor, other.lidar_from_sensor.inverse())
    ]
    assert apart_m[0] < 0.18
    assert apart_m[1] > 0.22


@pytest.mark.parametrize("text", ["1 2 3 4e", "0 0 0 0"])
def test_four_numbers_that_are_no_lens_are_refused(tmp_path: Path, text: str) -> None:
    files = robots.rellis()
    files["camera_info.txt"] = text
    rig = files["rig.yaml"]
    assert isinstance(rig, dict)
    rig["transforms"].append({"parent": "base_link", "child": "pylon_camera_node", "matrix": np.eye(4).tolist()})
    rig["sensors"] = {"CAM_BACK": {"frame": "pylon_camera_node", "width_px": 10, "height_px": 10}}
    with pytest.raises(StoneError, check=lambda error: error.code in ("CAL-411", "CAL-422")):
        read_any_calibration(robots.write(tmp_path / "mule", files))
