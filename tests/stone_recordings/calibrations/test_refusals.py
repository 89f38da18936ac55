"""What a file of a foreign format may not be: each refusal by its leaf and its sentence."""

import json
from pathlib import Path
from typing import Any

import pytest

from stone.errors import StoneError
from stone.sensors.calibration_errors import (
    CameraMatrixError,
    DisconnectedSensorError,
    DistortionLengthError,
    MirrorError,
    NotARotationError,
    NotFiniteError,
    QuaternionNormError,
    TranslationError,
)
from stone_recordings.calibrations.errors import (
    AmbiguousRigError,
    CalibrationKeyError,
    ConflictingFilesError,
    HalfRigError,
    LensModelError,
    ValidityError,
)
from stone_recordings.calibrations.file import read_any_calibration
from tests.stone_recordings.calibrations import robots


def refused(tmp_path: Path, files: dict[str, Any], leaf: type[StoneError], match: str) -> None:
    with pytest.raises(leaf, match=match) as reason:
        read_any_calibration(robots.write(tmp_path / "mule", files))
    assert "\n" not in str(reason.value)


@pytest.mark.parametrize(
    ("key", "value", "leaf", "match"),
    [
        ("distortion_model", "fov", LensModelError, "camera_front has the lens model 'fov'"),
        ("distortion_model", "rational_polynomial", DistortionLengthError, "5 distortion coefficients"),
        ("camera_matrix", {"data": [0.0] * 9}, CalibrationKeyError, "rows fx 0 cx, 0 fy cy, 0 0 1"),
        ("camera_matrix", {"data": [0, 0, 9, 0, 0, 9, 0, 0, 1]}, CameraMatrixError, "fx_px is 0"),
        ("camera_matrix", {"data": [9, 0, "nan", 0, 9, 9, 0, 0, 1]}, NotFiniteError, "the camera matrix holds NaN"),
        ("camera_matrix", {"data": [1, 2, 3]}, CalibrationKeyError, "camera_matrix.data: 3 rows of 3 numbers"),
        ("camera_matrix", {"data": [9, 0.1, 9, 0, 9, 9, 0, 0, 1]}, CalibrationKeyError, "without skew"),
        ("camera_matrix", {}, CalibrationKeyError, "camera_matrix.data: Field required"),
        ("camera_matrix", {"data": "many"}, CalibrationKeyError, "a list is expected, not 'many'"),
        ("camera_matrix", 5, CalibrationKeyError, "camera_matrix: a mapping is expected, not '5'"),
        (
            "image_width",
            640.5,
            CalibrationKeyError,
            "a whole number of pixels from 1 to 100000 is expected, not '640.5'",
        ),
        ("image_width", "wide", CalibrationKeyError, "a number is expected, not 'wide'"),
        ("image_width", True, CalibrationKeyError, "a number is expected, not 'True'"),
        ("image_width", 10**400, CalibrationKeyError, "image_width: a number is expected"),
        ("camera_name", "n" * 101, CalibrationKeyError, "a text of at most 100 characters"),
    ],
)
def test_a_wrong_camera_info_is_refused_by_its_key(
    tmp_path: Path, key: str, value: object, leaf: type[StoneError], match: str
) -> None:
    files = robots.ros_matrices()
    files["camera_front.yaml"][key] = value
    refused(tmp_path, files, leaf, match)


@pytest.mark.parametrize(
    ("matrix", "leaf", "match"),
    [
        ([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]], MirrorError, "it mirrors"),
        ([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1.01, 0], [0, 0, 0, 1]], NotARotationError, "not a rotation"),
        ([[1, 0, 0, 200], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], TranslationError, "200 m long"),
        ([["inf", 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], NotFiniteError, "NaN or infinity"),
        ([[1, 0, 0], [0, 1, 0], [0, 0, 1]], CalibrationKeyError, "4 rows of 4 numbers are expected"),
        ([[1, 0, 0, 0], [0, 1], [0, 0, 1], [0]], CalibrationKeyError, "4 rows of 4 numbers are expected"),
    ],
)
@pytest.mark.parametrize("writer", [robots.ros_matrices, robots.kalibr])
def test_a_matrix_that_is_no_transform_is_refused(
    tmp_path: Path, writer: Any, matrix: object, leaf: type[StoneError], match: str
) -> None:
    files = writer()
    if "camchain.yaml" in files:
        files["camchain.yaml"]["cam0"]["T_cam_imu"] = matrix
    else:
        files["frames.yaml"]["T_base_link__camera_front"] = matrix
    refused(tmp_path, files, leaf, match)


def test_a_lens_that_is_placed_nowhere_is_named(tmp_path: Path) -> None:
    files = robots.ros_matrices()
    del files["frames.yaml"]["T_base_link__camera_left"]
    refused(tmp_path, files, DisconnectedSensorError, "CAM_LEFT: its frame 'camera_left' has no path .* 'hesai_lidar'")


def test_a_tree_in_two_pieces_is_refused(tmp_path: Path) -> None:
    files = robots.ros_matrices()
    files["frames.yaml"]["T_tower__camera_left"] = files["frames.yaml"].pop("T_base_link__camera_left")
    refused(tmp_path, files, DisconnectedSensorError, "CAM_LEFT")


def test_two_files_that_disagree_are_refused_and_named(tmp_path: Path) -> None:
    files = robots.ros_matrices()
    other = [float(value) for value in files["frames.yaml"]["T_base_link__camera_left"]["data"]]
    other[3] += 0.01
    files["later.yaml"] = {"T_base_link__camera_left": other}
    refused(
        tmp_path,
        files,
        ConflictingFilesError,
        r"frames\.yaml and later\.yaml disagree about the transform from camera_left",
    )
    files = robots.ros_matrices()
    files["twice.yaml"] = {**files["camera_left.yaml"], "image_width": 961}
    refused(tmp_path / "again", files, ConflictingFilesError, "disagree about the intrinsics of camera_left")


def test_what_completes_a_rig_is_said_once(tmp_path: Path) -> None:
    files = {**robots.kalibr(), "other.yaml": {"stone_rig": 1}}
    refused(tmp_path, files, ConflictingFilesError, "other.yaml and rig.yaml disagree about the rest of the rig")


def test_a_native_file_stands_alone(tmp_path: Path) -> None:
    files = {**robots.ros_matrices(), "native.yaml": {"stone_calibration": 1}}
    refused(tmp_path, files, ConflictingFilesError, "a native file describes completely")


@pytest.mark.parametrize(
    ("rig", "match"),
    [
        ({"lidar": "velodyne"}, "rig lidar: no transform names the frame 'velodyne'; there are"),
        ({"ego": "car"}, "rig ego: no transform names the frame 'car'"),
        ({"lidra": "imu0"}, "lidra: Extra inputs are not permitted"),
        ({"transforms": [{"parent": "a", "child": "b"}]}, "transforms.0: give either matrix, or translation_m"),
    ],
)
def test_a_rig_document_that_means_nothing_is_refused(tmp_path: Path, rig: dict[str, Any], match: str) -> None:
    files = robots.kalibr()
    files["rig.yaml"] = {**files["rig.yaml"], **rig}
    refused(tmp_path, files, CalibrationKeyError, match)


def test_two_lidars_are_not_chosen_between(tmp_path: Path) -> None:
    files = robots.ros_matrices()
    files["frames.yaml"]["T_base_link__rear_lidar"] = files["frames.yaml"]["T_base_link__imu"]
    refused(
        tmp_path, files, AmbiguousRigError, "the LiDAR could be any of hesai_lidar, rear_lidar; .*`lidar: hesai_lidar`"
    )
    files["rig.yaml"] = {"stone_rig": 1, "lidar": "hesai_lidar"}
    found = read_any_calibration(robots.write(tmp_path / "mule", files)).calibration
    assert [mount.name for mount in found.of_kind("lidar")] == ["rear_lidar"]


def test_a_lidar_that_nobody_places_on_the_robot_is_half_a_rig(tmp_path: Path) -> None:
    files = robots.kalibr()
    del files["rig.yaml"]["transforms"][0]
    refused(tmp_path, files, HalfRigError, "no transform places hesai_lidar on the robot")


@pytest.mark.parametrize(
    ("key", "value", "leaf", "match"),
    [
        ("camera_model", "omni", LensModelError, "cam0 has the lens model 'omni'"),
        ("distortion_model", "fov", LensModelError, "'fov'"),
        ("distortion_coeffs", [0.1, 0.2], DistortionLengthError, "2 distortion coefficients"),
        ("intrinsics", [1, 2, 3], CalibrationKeyError, "four numbers fu, fv, pu, pv"),
        ("resolution", [1], CalibrationKeyError, "width and height are expected"),
        ("timeshift_cam_imu", 1e9, CalibrationKeyError, "a time of at most 1000 s"),
        ("timeshift_cam_imu", "nan", CalibrationKeyError, "a time of at most 1000 s"),
    ],
)
def test_a_wrong_camchain_is_refused_by_its_key(
    tmp_path: Path, key: str, value: object, leaf: type[StoneError], match: str
) -> None:
    files = robots.kalibr()
    files["camchain.yaml"]["cam0"][key] = value
    refused(tmp_path, files, leaf, match)


def test_opencalib_that_contradicts_itself_is_refused(tmp_path: Path) -> None:
    files = json.loads(json.dumps(robots.opencalib()))
    files["camera_front.json"]["camera_front-intrinsic"]["param"]["cam_dist"]["data"][0].append(0.5)
    refused(tmp_path, files, CalibrationKeyError, "1 x 4 numbers are declared and 1 x 5 given")


def test_a_time_lag_is_not_applied_and_that_is_said(tmp_path: Path) -> None:
    files = robots.opencalib()
    files["lidar-to-camera_front.json"]["hesai_lidar-to-camera_front-extrinsic"]["param"]["time_lag"] = 0.02
    read = read_any_calibration(robots.write(tmp_path / "mule", files))
    assert [(finding.code, finding.severity) for finding in read.findings] == [
        ("CAL-432", "warning"),
        ("CAL-436", "info"),
    ]
    assert {mount.time_offset_ns for mount in read.calibration.mounts} == {0}


def test_a_wrong_nuscenes_table_is_refused(tmp_path: Path) -> None:
    files = robots.nuscenes()
    rows = files["calibrated_sensor.json"]
    twice = {**rows[1], "translation": [9, 0, 0]}
    refused(
        tmp_path,
        {**files, "calibrated_sensor.json": [*rows, twice]},
        ConflictingFilesError,
        "the extrinsics of CAM_FRONT",
    )
    scaled = {**rows[1], "rotation": [2 * value for value in rows[1]["rotation"]]}
    refused(tmp_path, {**files, "calibrated_sensor.json": [rows[0], scaled]}, QuaternionNormError, "norm 2")
    stray = {**rows[1], "sensor_token": "nobody"}
    refused(
        tmp_path, {**files, "calibrated_sensor.json": [stray]}, CalibrationKeyError, "no row of sensor.json has this"
    )


def test_a_tf_quaternion_of_another_length_is_refused(tmp_path: Path) -> None:
    files = robots.ros_tf()
    files["tf.yaml"] = files["tf.yaml"].replace('"w": ', '"w": 1')
    refused(tmp_path, files, QuaternionNormError, "the quaternion has norm")


def test_every_leaf_says_its_code() -> None:
    codes = {leaf.code for leaf in StoneError.__subclasses__() if str(getattr(leaf, "code", "")).startswith("CAL-")}
    assert {"CAL-405", "CAL-416", ValidityError.code, *(f"CAL-42{digit}" for digit in "01234578"), "CAL-429"} <= codes
