"""One robot, written in every format, is read as that robot: frames, lenses, times, in file, folder and zip."""

import json
import os
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stone.sensors.calibration import CameraIntrinsics
from stone_files.calibration_bundle import read_bundle, zipped
from stone_recordings.calibrations.file import CalibrationRead, calibration_sha256, read_any_calibration
from testing.refusals import refused_as
from tests.stone_recordings.calibrations import robots

RADTAN_LENSES = {
    frame: replace(lens, model="plumb_bob", distortion=(*lens.distortion[:4], 0.0))
    for frame, lens in robots.LENSES.items()
}
RECTIFIED = {frame: replace(lens, model="pinhole", distortion=()) for frame, lens in robots.LENSES.items()}
WRITERS: dict[str, tuple[Callable[[], dict[str, object]], str, dict[str, CameraIntrinsics]]] = {
    "matrices": (robots.ros_matrices, "ros_camera_info", robots.LENSES),
    "tree": (robots.ros_tf, "ros_camera_info", robots.LENSES), "kalibr": (robots.kalibr, "kalibr", robots.LENSES),
    "opencalib": (robots.opencalib, "opencalib", RADTAN_LENSES), "nuscenes": (robots.nuscenes, "nuscenes", RECTIFIED),
    "autoware": (robots.autoware, "autoware", robots.LENSES), "rellis": (robots.rellis, "rellis", robots.LENSES),
    "opencv": (robots.opencv, "opencv", robots.LENSES),
}  # fmt: skip


@pytest.fixture(params=WRITERS)
def written(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Path, str, dict[str, CameraIntrinsics]]:
    writer, format_name, lenses = WRITERS[request.param]
    return robots.write(tmp_path / "mule", writer()), format_name, lenses


def check(read: CalibrationRead, lenses: dict[str, CameraIntrinsics]) -> None:
    found = read.calibration
    np.testing.assert_allclose(found.ego_from_lidar.as_matrix(), robots.EGO_FROM["hesai_lidar"], atol=1e-9)
    for channel, frame in robots.CAMERAS.items():
        mount = found.mount(channel)
        assert mount is not None, channel
        np.testing.assert_allclose(
            mount.lidar_from_sensor.as_matrix(), robots.relative("hesai_lidar", frame), atol=1e-9, err_msg=channel
        )
        assert mount.intrinsics == lenses[frame]


def test_every_format_is_read_as_the_robot_it_was_written_from_zipped_too(written, tmp_path):
    folder, format_name, lenses = written
    read = read_any_calibration(folder)
    assert read.format == format_name
    assert read.calibration.name == "mule"
    check(read, lenses)
    assert {finding.severity for finding in read.findings} <= {"info"}
    packed = tmp_path / "mule.zip"
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in sorted(folder.iterdir()):
            archive.write(file, f"calibration/{file.name}")
    read = read_any_calibration(packed)
    assert (read.format, read.calibration.name) == (format_name, "mule")
    check(read, lenses)


def test_kalibr_shifts_the_cameras_stamps_and_its_chain_is_followed_without_an_imu(tmp_path: Path) -> None:
    found = read_any_calibration(robots.write(tmp_path / "a", robots.kalibr())).calibration
    assert [found.mount(channel).time_offset_ns for channel in robots.CAMERAS] == [-12_500_000] * 2
    imu = found.mount("IMU")
    np.testing.assert_allclose(imu.lidar_from_sensor.as_matrix(), robots.relative("hesai_lidar", "imu"), atol=1e-9)
    files = robots.kalibr()
    chain, rig = files["camchain.yaml"], files["rig.yaml"]
    for camera in chain.values():
        del camera["T_cam_imu"]
    rig["transforms"][1] = {
        "parent": "cam0",
        "child": "hesai_lidar",
        "matrix": robots.relative("camera_front", "hesai_lidar").tolist(),
    }
    check(read_any_calibration(robots.write(tmp_path / "a", files)), robots.LENSES)


@pytest.mark.parametrize("spelling", ["T_imu_cam", "flat", "opencv head"])
def test_the_spellings_of_open_vins_and_msckf_mean_the_same(tmp_path: Path, spelling: str) -> None:
    files = robots.kalibr()
    chain = files["camchain.yaml"]
    for camera in chain.values():
        matrix = np.array(camera.pop("T_cam_imu"))
        if spelling == "T_imu_cam":
            camera["T_imu_cam"] = np.linalg.inv(matrix).tolist()
        else:
            camera["T_cam_imu"] = matrix.ravel().tolist() if spelling == "flat" else matrix.tolist()
    folder = robots.write(tmp_path / "a", files)
    if spelling == "opencv head":
        file = folder / "camchain.yaml"
        file.write_text("%YAML:1.0 # need to specify the file type\n\n" + file.read_text())
    check(read_any_calibration(folder), robots.LENSES)


def test_a_link_is_turned_to_its_optical_frame_and_that_is_said(tmp_path: Path) -> None:
    read = read_any_calibration(robots.write(tmp_path / "a", robots.autoware()))
    turned = [finding for finding in read.findings if finding.code == "CAL-430"]
    assert [(finding.topic, finding.severity) for finding in turned] == [("CAM_FRONT", "info"), ("CAM_LEFT", "info")]
    assert read.calibration.mount("CAM_FRONT").frame_id == "camera_front/camera_optical_link"


def test_a_rotation_matrix_in_a_nuscenes_table_is_read_with_a_warning(tmp_path: Path) -> None:
    files = robots.nuscenes()
    files["calibrated_sensor.json"][1]["rotation"] = robots.EGO_FROM["camera_front"][:3, :3].tolist()
    read = read_any_calibration(robots.write(tmp_path / "a", files))
    check(read, RECTIFIED)
    assert [(finding.code, finding.topic) for finding in read.findings] == [("CAL-402", "CAM_FRONT"), ("CAL-436", "")]


def test_images_of_unknown_size_leave_a_camera_without_a_lens_and_say_so(tmp_path: Path) -> None:
    files = robots.nuscenes()
    del files["rig.yaml"]
    read = read_any_calibration(robots.write(tmp_path / "a", files))
    assert [mount.intrinsics for mount in read.calibration.of_kind("camera")] == [None, None]
    assert [(finding.code, finding.severity) for finding in read.findings] == [
        ("CAL-436", "info"),
        *[("CAL-426", "warning")] * 2,
    ]


def test_of_several_bases_the_one_on_the_ground_is_the_ego_frame(tmp_path: Path) -> None:
    files = robots.ros_matrices()
    down = np.eye(4)
    down[2, 3] = -0.068
    files["frames.yaml"]["T_base_link__base_footprint"] = {"data": down.ravel().tolist()}
    found = read_any_calibration(robots.write(tmp_path / "a", files)).calibration
    expected = np.linalg.inv(down) @ robots.EGO_FROM["hesai_lidar"]
    np.testing.assert_allclose(found.ego_from_lidar.as_matrix(), expected, atol=1e-9)


def test_a_camera_info_message_as_ros_prints_it_is_a_lens(tmp_path: Path) -> None:
    files = robots.ros_matrices()
    lens = robots.LENSES["camera_front"]
    message = {
        "header": {"frame_id": "/camera_front"},
        "height": lens.height_px,
        "width": lens.width_px,
        "distortion_model": "plumb_bob",
        "d": list(lens.distortion),
        "k": [value for row in robots.camera_matrix(lens) for value in row],
    }
    files["camera_front.yaml"] = message
    check(read_any_calibration(robots.write(tmp_path / "a", files)), robots.LENSES)


def test_a_folder_is_sent_as_a_zip_that_says_the_same_and_has_a_hash_that_any_byte_changes(written, tmp_path):
    folder, _, lenses = written
    packed = zipped(read_bundle(folder))
    for file in folder.iterdir():
        os.utime(file, (1e9, 1e9))
    assert zipped(read_bundle(folder)) == packed
    path = tmp_path / "sent.zip"
    path.write_bytes(packed)
    check(read_any_calibration(path), lenses)
    folder, _, _ = written
    before = calibration_sha256(folder)
    assert calibration_sha256(folder) == before
    file = next(file for file in folder.iterdir() if file.suffix in (".yaml", ".json"))
    file.write_bytes(file.read_bytes() + b"\n")
    assert calibration_sha256(folder) != before


def refused(tmp_path: Path, files: dict[str, Any], leaf: str) -> None:
    with refused_as(leaf) as reason:
        read_any_calibration(robots.write(tmp_path / "mule", files))
    assert "\n" not in str(reason.value)


@pytest.mark.parametrize(
    ("key", "value", "leaf"),
    [
        ("distortion_model", "fov", "CAL-427"),
        ("distortion_model", "rational_polynomial", "CAL-410"),
        ("camera_matrix", {"data": [0.0] * 9}, "CAL-422"),
        ("camera_matrix", {"data": [0, 0, 9, 0, 0, 9, 0, 0, 1]}, "CAL-411"),
        ("camera_matrix", {"data": [9, 0, "nan", 0, 9, 9, 0, 0, 1]}, "CAL-416"),
        ("camera_matrix", {"data": [1, 2, 3]}, "CAL-422"),
        ("camera_matrix", {"data": [9, 0.1, 9, 0, 9, 9, 0, 0, 1]}, "CAL-422"),
        ("camera_matrix", {}, "CAL-422"), ("camera_matrix", {"data": "many"}, "CAL-422"),
        ("camera_matrix", 5, "CAL-422"), ("image_width", 640.5, "CAL-422"),
        ("image_width", "wide", "CAL-422"), ("image_width", True, "CAL-422"),
        ("image_width", 10**400, "CAL-422"), ("camera_name", "n" * 101, "CAL-422"),
    ],
)  # fmt: skip
def test_a_wrong_camera_info_is_refused_by_its_key(tmp_path, key, value, leaf):
    files = robots.ros_matrices()
    files["camera_front.yaml"][key] = value
    refused(tmp_path, files, leaf)


@pytest.mark.parametrize(
    ("matrix", "leaf"),
    [
        ([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]], "CAL-408"),
        ([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1.01, 0], [0, 0, 0, 1]], "CAL-401"),
        ([[1, 0, 0, 200], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], "CAL-409"),
        ([["inf", 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], "CAL-416"),
        ([[1, 0, 0], [0, 1, 0], [0, 0, 1]], "CAL-422"),
        ([[1, 0, 0, 0], [0, 1], [0, 0, 1], [0]], "CAL-422"),
    ],
)
@pytest.mark.parametrize("writer", [robots.ros_matrices, robots.kalibr])
def test_a_matrix_that_is_no_transform_is_refused(tmp_path, writer, matrix, leaf):
    files = writer()
    if "camchain.yaml" in files:
        files["camchain.yaml"]["cam0"]["T_cam_imu"] = matrix
    else:
        files["frames.yaml"]["T_base_link__camera_front"] = matrix
    refused(tmp_path, files, leaf)


def camera_left_elsewhere(files: Any) -> None:
    frames = files["frames.yaml"]
    other = [float(value) for value in frames["T_base_link__camera_left"]["data"]]
    other[3] += 0.01
    files["later.yaml"] = {"T_base_link__camera_left": other}


def row_of_front(files: Any, **values: Any) -> None:
    """A row of the table more, like CAM_FRONT's but for these values."""
    rows = files["calibrated_sensor.json"]
    rows.append({**rows[1], **values})


RIGS: list[tuple[Any, Callable[[Any], Any], str]] = [
    (robots.ros_matrices, lambda f: f["frames.yaml"].pop("T_base_link__camera_left"), "CAL-405"),
    (robots.ros_matrices, lambda f: f["frames.yaml"].update(
        T_tower__camera_left=f["frames.yaml"].pop("T_base_link__camera_left")), "CAL-405"),
    (robots.ros_matrices, camera_left_elsewhere, "CAL-429"),
    (robots.ros_matrices, lambda f: f.update({"twice.yaml": {**f["camera_left.yaml"], "image_width": 961}}),
     "CAL-429"),
    (robots.kalibr, lambda f: f.update({"other.yaml": {"stone_rig": 1}}), "CAL-429"),
    (robots.ros_matrices, lambda f: f.update({"native.yaml": {"stone_calibration": 1}}), "CAL-429"),
    (robots.kalibr, lambda f: f["rig.yaml"].update(lidar="velodyne"), "CAL-422"),
    (robots.kalibr, lambda f: f["rig.yaml"].update(ego="car"), "CAL-422"),
    (robots.kalibr, lambda f: f["rig.yaml"].update(lidra="imu0"), "CAL-422"),
    (robots.kalibr, lambda f: f["rig.yaml"].update(transforms=[{"parent": "a", "child": "b"}]), "CAL-422"),
    (robots.kalibr, lambda f: f["rig.yaml"]["transforms"].pop(0), "CAL-424"),
    (robots.opencalib, lambda f: f["camera_front.json"]["camera_front-intrinsic"]["param"]["cam_dist"]["data"][0]
     .append(0.5), "CAL-422"),
    (robots.nuscenes, lambda f: row_of_front(f, translation=[9, 0, 0]), "CAL-429"),
    (robots.nuscenes, lambda f: f["calibrated_sensor.json"][1].update(rotation=[2, 0, 0, 0]), "CAL-402"),
    (robots.nuscenes, lambda f: row_of_front(f, sensor_token="nobody"), "CAL-422"),
    (robots.ros_tf, lambda f: f.update({"tf.yaml": f["tf.yaml"].replace('"w": ', '"w": 1')}), "CAL-402"),
]  # fmt: skip


@pytest.mark.parametrize(("writer", "spoil", "leaf"), RIGS)
def test_a_rig_that_cannot_be_is_refused(tmp_path: Path, writer: Any, spoil: Any, leaf: str) -> None:
    files = json.loads(json.dumps(writer()))
    spoil(files)
    refused(tmp_path, files, leaf)


def test_two_lidars_are_not_chosen_between(tmp_path: Path) -> None:
    files: Any = robots.ros_matrices()
    files["frames.yaml"]["T_base_link__rear_lidar"] = files["frames.yaml"]["T_base_link__imu"]
    refused(tmp_path, files, "CAL-425")
    files["rig.yaml"] = {"stone_rig": 1, "lidar": "hesai_lidar"}
    found = read_any_calibration(robots.write(tmp_path / "mule", files)).calibration
    assert [mount.name for mount in found.of_kind("lidar")] == ["rear_lidar"]


@pytest.mark.parametrize(
    ("key", "value", "leaf"),
    [
        ("camera_model", "omni", "CAL-427"), ("distortion_model", "fov", "CAL-427"),
        ("distortion_coeffs", [0.1, 0.2], "CAL-410"), ("intrinsics", [1, 2, 3], "CAL-422"),
        ("resolution", [1], "CAL-422"), ("timeshift_cam_imu", 1e10, "CAL-422"),
        ("timeshift_cam_imu", "nan", "CAL-422"),
    ],
)  # fmt: skip
def test_a_wrong_camchain_is_refused_by_its_key(tmp_path, key, value, leaf):
    files = robots.kalibr()
    files["camchain.yaml"]["cam0"][key] = value
    refused(tmp_path, files, leaf)


def test_a_time_lag_is_not_applied_and_that_is_said(tmp_path: Path) -> None:
    files = robots.opencalib()
    files["lidar-to-camera_front.json"]["hesai_lidar-to-camera_front-extrinsic"]["param"]["time_lag"] = 0.02
    read = read_any_calibration(robots.write(tmp_path / "mule", files))
    assert [(finding.code, finding.severity) for finding in read.findings] == [
        ("CAL-432", "warning"),
        ("CAL-436", "info"),
    ]
    assert {mount.time_offset_ns for mount in read.calibration.mounts} == {0}
