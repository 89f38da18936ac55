"""OpenCV's FileStorage: what OpenCV itself wrote, the directions of its transforms, and what else a tag may not be."""

import copy
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stone.errors import StoneError
from stone.sensors.calibration import CameraIntrinsics
from stone_files.calibration_bundle import Bundle
from stone_recordings.calibrations.errors import CalibrationYamlError
from stone_recordings.calibrations.file import CalibrationRead, read_any_calibration, read_files
from testing.refusals import refused_as
from tests.stone_recordings.calibrations import robots

# By cv2.FileStorage of OpenCV 5; older ones begin with %YAML:1.0.
WRITTEN_BY_OPENCV = """\
%YAML 1.2
---
calibration_time: "Mon Nov 23 19:25:39 2026"
image_width: 1920
image_height: 1200
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 1179.4000000000001, 0., 983.89999999999998, 0.,
       1178.9000000000001, 596.70000000000005, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -0.22, 0.070000000000000007, 0.0001, -0.00020000000000000001,
       0. ]
avg_reprojection_error: 0.31
R: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 0., -1., 0., 0., 0., -1., 1., 0., 0. ]
T: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: [ 0.10000000000000001, -0.20000000000000001,
       -0.29999999999999999 ]
"""
RIG = robots.opencv()["rig.yaml"]
WORDS = ["", "x", "-1", "1e400", ".nan", "[", "]", "{", "R:", "!!opencv-matrix", "\n", "rows:", "0"]


def read(tmp_path: Path, text: str, rig: Any = RIG) -> CalibrationRead:
    return read_any_calibration(robots.write(tmp_path / "mule", {"front.yml": text, "rig.yaml": rig}))


def camera_of(found: CalibrationRead) -> Any:
    return found.calibration.of_kind("camera")[0]


@pytest.mark.parametrize("head", ["%YAML 1.2\n---\n", "%YAML:1.0\n---\n", "%YAML:1.0\n", "%YAML:1.0\r\n---\r\n"])
def test_what_opencv_wrote_is_read_to_the_last_digit(tmp_path: Path, head: str) -> None:
    found = read(tmp_path, WRITTEN_BY_OPENCV.replace("%YAML 1.2\n---\n", head))
    assert found.format == "opencv"
    camera = camera_of(found)
    distortion = (-0.22, 0.07, 1e-4, -2e-4, 0.0)
    assert camera.intrinsics == CameraIntrinsics("plumb_bob", 1920, 1200, 1179.4, 1178.9, 983.9, 596.7, distortion)
    # A LiDAR's point at x forward is z forward of the camera, and the LiDAR itself is 0.3 m behind it.
    camera_from_lidar = camera.lidar_from_sensor.inverse()
    np.testing.assert_allclose(camera_from_lidar @ np.array([5.0, 0.0, 0.0]), (0.1, -0.2, 4.7), atol=1e-12)


def test_autowares_extrinsic_is_the_other_way_round(tmp_path: Path) -> None:
    lidar_from_camera = robots.relative("hesai_lidar", "camera_front")
    text = "%YAML:1.0\n---\n" + robots.opencv_matrix("CameraExtrinsicMat", lidar_from_camera)
    text += robots.opencv_matrix("CameraMat", np.array(robots.camera_matrix(robots.LENSES["camera_front"])))
    text += robots.opencv_matrix("DistCoeff", np.zeros((1, 5))) + "ImageSize: [1920, 1200]\nDistModel: plumb_bob\n"
    found = camera_of(read(tmp_path, text))
    np.testing.assert_allclose(found.lidar_from_sensor.as_matrix(), lidar_from_camera, atol=1e-9)
    nobody_measured = text.replace(
        robots.opencv_matrix("CameraExtrinsicMat", lidar_from_camera),
        robots.opencv_matrix("CameraExtrinsicMat", np.eye(4)),
    )
    with pytest.raises(StoneError):
        read(tmp_path, nobody_measured)


def test_a_camera_on_the_body_of_vins_hangs_on_its_imu(tmp_path: Path) -> None:
    text = "%YAML:1.0\n---\n" + robots.opencv_matrix("body_T_cam0", robots.relative("imu", "camera_front"))
    to_imu = {"parent": "lidar", "child": "body", "matrix": robots.relative("hesai_lidar", "imu").tolist()}
    rig = {"stone_rig": 1, "transforms": [*RIG["transforms"], to_imu]}  # type: ignore[index]
    found = read(tmp_path, text, rig).calibration
    by_name = {mount.name: mount.lidar_from_sensor.as_matrix() for mount in found.mounts}
    np.testing.assert_allclose(by_name["cam0"], robots.relative("hesai_lidar", "camera_front"), atol=1e-9)
    np.testing.assert_allclose(by_name["IMU"], robots.relative("hesai_lidar", "imu"), atol=1e-9)


def test_a_stereo_pair_without_tags_is_second_from_first(tmp_path: Path) -> None:
    found = read_any_calibration(robots.write(tmp_path / "mule", robots.stereo()))
    right = found.calibration.mount("CAM_RIGHT")
    assert right is not None
    np.testing.assert_allclose(
        right.lidar_from_sensor.as_matrix(), robots.relative("hesai_lidar", "camera_left"), atol=1e-9
    )


def test_a_transform_the_wrong_way_round_is_doubted(tmp_path: Path) -> None:
    turned = WRITTEN_BY_OPENCV.replace("0., -1., 0., 0., 0., -1., 1., 0., 0.", "0., 0., 1., -1., 0., 0., 0., -1., 0.")
    base = {"parent": "base_link", "child": "lidar", "translation_m": [0, 0, 1], "rotation_wxyz": [1, 0, 0, 0]}
    rig = {"stone_rig": 1, "transforms": [base]}
    found = read(tmp_path, turned, rig).findings
    assert {finding.code for finding in found} == {"CAL-404", "CAL-436"}
    assert [finding.code for finding in read(tmp_path, WRITTEN_BY_OPENCV, rig).findings] == ["CAL-436"]


@pytest.mark.parametrize(
    ("old", "new", "leaf"),
    [
        ("rows: 5", "rows: 4", "CAL-422"),
        ("rows: 3\n   cols: 3", "rows: 2\n   cols: 3", "CAL-422"),
        ("1179.4000000000001", ".Nan", "CAL-422"),
        ("1179.4000000000001", ".nan", "CAL-416"),
        ("1., 0., 0. ]\nT", "-1., 0., 0. ]\nT", "CAL-408"),
        ("-0.29999999999999999 ]", "-.inf ]", "CAL-416"),
        ("image_width: 1920", "image_width: wide", "CAL-422"),
        ("rows: 5", "rows: 1e9", "CAL-422"),
        ("avg_reprojection_error: 0.31", "fisheye_model: 1", "CAL-410"),
    ],
)
def test_a_wrong_value_is_refused_by_its_key(tmp_path: Path, old: str, new: str, leaf: str) -> None:
    assert old in WRITTEN_BY_OPENCV
    with refused_as(leaf) as reason:
        read(tmp_path, WRITTEN_BY_OPENCV.replace(old, new))
    assert "\n" not in str(reason.value)


def test_thin_prisms_are_refused_and_their_zeros_are_not(tmp_path: Path) -> None:
    given = robots.opencv_matrix("distortion_coefficients", np.array([[-0.22, 0.07, 0, 0, 0.0]]).T)
    fourteen = robots.opencv_matrix("distortion_coefficients", np.array([[-0.22, 0.07, *[0.0] * 12]]).T)
    text = robots.opencv()["camera_front.yml"]
    assert isinstance(text, str)
    text = text.replace(text[text.index("distortion_coefficients") : text.index("R: ")], given)
    assert camera_of(read(tmp_path, text)).intrinsics.model == "plumb_bob"
    assert camera_of(read(tmp_path, text.replace(given, fourteen))).intrinsics.model == "rational_polynomial"
    with refused_as("CAL-427"):
        read(tmp_path, text.replace(given, fourteen.replace("0 ]", "0.5 ]")))


def test_matrices_that_are_unknown_too_deep_too_large_or_half_a_rig_are_refused(tmp_path: Path) -> None:
    with refused_as("CAL-422"):
        read(tmp_path, "%YAML:1.0\n---\n" + robots.opencv_matrix("homography", np.eye(3)))
    deep = "camera_matrix: !!opencv-matrix {data: " + "[" * 50 + "]" * 50 + "}\n"
    with pytest.raises(CalibrationYamlError):
        read(tmp_path, "%YAML:1.0\n---\n" + deep)
    with pytest.raises(CalibrationYamlError):
        read(tmp_path, "%YAML:1.0\n---\ncamera_matrix: !!opencv-matrix {data: [" + "0," * 20_000 + "0]}\n")
    (tmp_path / "front.yml").write_text(WRITTEN_BY_OPENCV)
    with refused_as("CAL-424"):
        read_any_calibration(tmp_path / "front.yml")


@pytest.mark.parametrize(
    "text",
    [
        "camera_matrix: !!python/object/apply:os.system ['true']\n",
        "camera_matrix: !!python/object:builtins.dict {}\n",
        "camera_matrix: !!opencv-matrix [1, 2]\n",
        "camera_matrix: !!opencv-matrix 5\n",
        "camera_matrix: !!opencv-matrix-evil {rows: 1}\n",
        "camera_matrix: !opencv-matrix {rows: 1}\n",
        "camera_matrix: !!opencv-matrix {rows: !!python/name:os.system '', cols: 1}\n",
        "camera_matrix: !!opencv-matrix &a {rows: 1, cols: *a}\n",
    ],
)
def test_every_other_tag_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(CalibrationYamlError):
        read(tmp_path, "%YAML:1.0\n---\n" + text)


@settings(max_examples=80)
@given(st.data())
def test_no_word_in_the_file_is_more_than_a_refusal(data: st.DataObject) -> None:
    words = WRITTEN_BY_OPENCV.split(" ")
    for _ in range(data.draw(st.integers(1, 3))):
        place = data.draw(st.integers(0, len(words) - 1))
        words[place] = data.draw(st.sampled_from(WORDS))
    documents = (("front.yml", " ".join(words).encode()), ("rig.yaml", json.dumps(RIG).encode()))
    try:
        mounts = read_files(Bundle(documents), "rig.zip").calibration.mounts
    except StoneError as refused:
        check_sentence(refused)
        return
    assert all(np.isfinite(mount.lidar_from_sensor.wxyz_xyz).all() for mount in mounts)


WRITERS = [robots.ros_matrices, robots.kalibr, robots.opencalib, robots.nuscenes, robots.autoware]
WRITERS += [robots.rellis, robots.kitti, robots.stereo]
HOSTILE = [
    None, True, 0, -1, 1, 0.5, 10**400, 1e308, -1e308, 5e-324, float("nan"), float("inf"), "", "nan", "-inf", "1e999",
    "base_link", "hesai_lidar", "\x00", "\u202e", "x" * 200, [], {}, [[]], [[], []], [1], [[1]], ["a"] * 16,
    {"data": []}, {"data": 1}, [None] * 16, [[0] * 4] * 4, [[1e200] * 4] * 4, [[float("nan")] * 4] * 4, [0] * 16, [{}],
]  # fmt: skip


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The way to every value in nested lists and dicts."""
    keys = value if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ()
    for key in keys:
        yield (*path, key)
        yield from places(value[key], (*path, key))


def damage(files: Any, path: tuple[Any, ...], data: st.DataObject) -> None:
    """Put something else there, take it away, or call it something else."""
    for key in path[:-1]:
        files = files[key]
    how = data.draw(st.sampled_from(["replaced", "removed", "renamed", "repeated"]))
    if how == "removed":
        del files[path[-1]]
    elif how == "renamed" and isinstance(files, dict):
        files[data.draw(st.sampled_from(["", "a", "T_a__b", "cam0", "stone_rig", "sensor_kit_x"]))] = files.pop(
            path[-1]
        )
    elif how == "repeated" and isinstance(files, list):
        files.append(copy.deepcopy(files[path[-1]]))
    else:
        files[path[-1]] = copy.deepcopy(data.draw(st.sampled_from(HOSTILE)))


def check_sentence(refused: StoneError) -> None:
    assert "\n" not in str(refused)
    assert len(str(refused)) < 900
    assert refused.code.startswith("CAL-") or refused.code == "bad_shape"


@pytest.mark.whole
@pytest.mark.parametrize("writer", WRITERS)
@settings(max_examples=30)
@given(data=st.data())
def test_no_value_is_more_than_a_refusal(writer: Callable[[], dict[str, object]], data: st.DataObject) -> None:
    files = {name: content for name, content in copy.deepcopy(writer()).items() if not isinstance(content, str)}
    for _ in range(data.draw(st.integers(1, 3))):
        ways = list(places(files))
        if ways:
            damage(files, data.draw(st.sampled_from(ways)), data)
    documents = tuple((str(name) or "x", json.dumps(content).encode()) for name, content in sorted(files.items()))
    try:
        found = read_files(Bundle(documents), "rig.zip").calibration
    except StoneError as refused:
        check_sentence(refused)
        return
    for pose in (found.ego_from_lidar, *(mount.lidar_from_sensor for mount in found.mounts)):
        assert np.isfinite(pose.wxyz_xyz).all()
        assert np.linalg.norm(pose.wxyz) == pytest.approx(1, abs=1e-6)
