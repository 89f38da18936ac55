"""RELLIS-3D's example frame: the directions that are read put labelled points on pixels of their own class."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial import cKDTree

from stone.geometry.se3 import SE3
from stone.sensors.calibration import CameraIntrinsics, Mount
from stone.sensors.projection import project
from stone_recordings.calibrations.errors import CalibrationKeyError
from stone_recordings.calibrations.file import CalibrationRead, read_any_calibration
from tests.stone_recordings.calibrations import robots

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
def test_points_land_on_pixels_of_their_class_and_the_other_way_round_they_do_not(
    example: Path, read: CalibrationRead
) -> None:
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


def test_a_key_that_names_no_two_frames_is_refused(tmp_path: Path) -> None:
    files = robots.rellis()
    placed = files["transforms.yaml"]
    assert isinstance(placed, dict)
    files["transforms.yaml"] = {"hesai_lidar": placed["hesai_lidar-camera_front"]}
    with pytest.raises(CalibrationKeyError, match="two frames are expected"):
        read_any_calibration(robots.write(tmp_path / "mule", files))


@pytest.mark.parametrize(("text", "problem"), [("1 2 3 4e", "a number is expected"), ("0 0 0 0", "fx_px is 0")])
def test_four_numbers_that_are_no_lens_are_refused(tmp_path: Path, text: str, problem: str) -> None:
    files = robots.rellis()
    files["camera_info.txt"] = text
    rig = files["rig.yaml"]
    assert isinstance(rig, dict)
    rig["transforms"].append({"parent": "base_link", "child": "pylon_camera_node", "matrix": np.eye(4).tolist()})
    rig["sensors"] = {"CAM_BACK": {"frame": "pylon_camera_node", "width_px": 10, "height_px": 10}}
    with pytest.raises(Exception, match=problem):
        read_any_calibration(robots.write(tmp_path / "mule", files))
