"""A native calibration file is read as written; every other file is refused in one coded sentence."""

import pickle
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from stone.errors import StoneError
from stone.sensors.calibration import Box, Footprint
from stone.sensors.calibration_errors import DistortionLengthError, MirrorError, NotFiniteError, RepeatedSensorError
from stone_files.errors import CalibrationSizeError
from stone_recordings.calibrations.errors import (
    CalibrationFormatError,
    CalibrationKeyError,
    CalibrationYamlError,
)
from stone_recordings.calibrations.file import read_calibration

NATIVE = """\
stone_calibration: 1
name: stone-sim
footprint: {length_m: 1.06, width_m: 0.85}
self_boxes_ego: [{min_m: [-1, -0.5, 0], max_m: [1, 0.5, 1.2]}]
ego_from_lidar: {translation_m: [0.2, 0, 1.1], rotation_wxyz: [1, 0, 0, 0]}
sensors:
  CAM_FRONT:
    kind: camera
    frame_id: cam_front
    lidar_from_sensor: {translation_m: [0.1, 0.0, -0.2], rotation_wxyz: [0.5, -0.5, 0.5, -0.5]}
    time_offset_ns: -1500
    intrinsics: {model: plumb_bob, width_px: 1920, height_px: 1200, fx_px: 1000, fy_px: 1000.5, cx_px: 960, cy_px: 600,
                 distortion: [0.1, 0.02, 0, 0, 0.01]}
  RADAR_LEFT:
    kind: radar
    lidar_from_sensor: {translation_m: [0, 0.5, -0.4], rotation_matrix: [[0, -1, 0], [1, 0, 0], [0, 0, 1]]}
  INS:
    kind: ins
    lidar_from_sensor: {matrix: [[1, 0, 0, -0.3], [0, 1, 0, 0], [0, 0, 1, -0.5], [0, 0, 0, 1]]}
"""


@pytest.fixture
def written(tmp_path: Path):
    def write(text: str | bytes) -> Path:
        path = tmp_path / "cal.yaml"
        path.write_bytes(text.encode() if isinstance(text, str) else text)
        return path

    return write


def test_the_native_format_is_read_as_written(written):
    calibration, findings = read_calibration(written(NATIVE))
    assert findings == ()
    assert calibration.name == "stone-sim"
    assert calibration.footprint == Footprint(1.06, 0.85)
    assert calibration.self_boxes_ego == (Box((-1, -0.5, 0), (1, 0.5, 1.2)),)
    np.testing.assert_allclose(calibration.ego_from_lidar.translation_m, [0.2, 0, 1.1])
    camera = calibration.mount("CAM_FRONT")
    assert (camera.kind, camera.frame_id, camera.time_offset_ns) == ("camera", "cam_front", -1500)
    assert camera.intrinsics.distortion == (0.1, 0.02, 0, 0, 0.01)
    assert (camera.intrinsics.width_px, camera.intrinsics.fy_px) == (1920, 1000.5)
    np.testing.assert_allclose(camera.lidar_from_sensor @ np.array([0.0, 0, 1]), [1.1, 0, -0.2], atol=1e-12)
    np.testing.assert_allclose(
        calibration.mount("RADAR_LEFT").lidar_from_sensor @ np.array([1.0, 0, 0]), [0, 1.5, -0.4], atol=1e-12
    )
    np.testing.assert_allclose(calibration.mount("INS").lidar_from_sensor.translation_m, [-0.3, 0, -0.5])
    assert [mount.name for mount in calibration.of_kind("radar")] == ["RADAR_LEFT"]


def test_footprint_boxes_and_sensors_may_be_left_out_and_a_default_footprint_is_said(written):
    text = "stone_calibration: 1\nname: a\nego_from_lidar: {translation_m: [0, 0, 1], rotation_wxyz: [1, 0, 0, 0]}\n"
    calibration, findings = read_calibration(written(text))
    assert (calibration.footprint, calibration.mounts) == (Footprint(), ())
    assert [(finding.code, finding.severity) for finding in findings] == [("CAL-436", "info")]
    assert "1.06 x 0.85 m, the paper's robot" in findings[0].message
    assert read_calibration(written(text + "footprint: {length_m: 1.06, width_m: 0.85}\n"))[1] == ()


def test_the_shipped_example_is_read_without_a_finding():
    calibration, findings = read_calibration(Path(__file__).parents[3] / "examples" / "kitti0005.calibration.yaml")
    assert findings == ()
    assert calibration.footprint == Footprint(3.0, 1.6)


def test_a_mirror_is_refused_in_one_line(written):
    with pytest.raises(MirrorError, match="RADAR_LEFT: the rotation has determinant -1, so it mirrors") as refused:
        read_calibration(written(NATIVE.replace("[0, -1, 0], [1, 0, 0], [0, 0, 1]", "[0, 1, 0], [1, 0, 0], [0, 0, 1]")))
    assert "\n" not in str(refused.value)
    assert refused.value.code == "CAL-408"


def test_what_was_mended_is_said_and_names_the_sensor(written):
    _, findings = read_calibration(written(NATIVE.replace("[0, -1, 0], [1, 0, 0]", "[0.001, -1, 0], [1, 0, 0]")))
    assert [(f.code, f.severity, f.topic) for f in findings] == [("CAL-401", "warning", "RADAR_LEFT")]


def test_what_the_checks_refuse_is_refused_from_a_file(written):
    with pytest.raises(DistortionLengthError, match="CAM_FRONT: 4 distortion coefficients"):
        read_calibration(written(NATIVE.replace(", 0.01]", "]")))
    with pytest.raises(NotFiniteError, match="INS: the matrix holds NaN"):
        read_calibration(written(NATIVE.replace("0, -0.5]", "0, .nan]").replace("1, -0.5]", "1, .nan]")))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "lidar_from_sensor: {matrix",
            "sensor_from_lidar: {matrix",
            r"sensors\.INS\.lidar_from_sensor: Field required",
        ),
        ("width_m: 0.85", "width: 0.85", r"footprint\.width_m: Field required \(and 1 more\)"),
        ("name: stone-sim", "name: stone-sim\nextra: 1", r"extra: Extra inputs are not permitted, not '1'"),
        ("[0.2, 0, 1.1]", "[0.2, 0]", r"ego_from_lidar\.translation_m: List should have at least 3"),
        (
            "[0.2, 0, 1.1]",
            "[0.2, 0, high]",
            r"ego_from_lidar\.translation_m\.2: Input should be a valid number, not 'h",
        ),
        ("[0.2, 0, 1.1]", "[0.2, 0, '1.1']", r"translation_m\.2: Input should be a valid number, not '1\.1'"),
        ("[0.2, 0, 1.1]", "[0.2, 0, true]", r"translation_m\.2: Input should be a valid number"),
        ("rotation_wxyz: [1, 0, 0, 0]}", "matrix: [[1]]}", r"ego_from_lidar\.matrix"),
        (", rotation_wxyz: [1, 0, 0, 0]}", "}", r"ego_from_lidar: give either matrix, or translation_m with one of"),
        ("kind: ins", "kind: gnss", r"sensors\.INS\.kind: Input should be 'camera'"),
        ("stone_calibration: 1", "stone_calibration: 2", r"stone_calibration: Input should be 1, not '2'"),
        ("-1500", "1.5", r"sensors\.CAM_FRONT\.time_offset_ns: Input should be a valid integer"),
        ("width_px: 1920", "width_px: -1", r"intrinsics\.width_px: Input should be greater than 0"),
    ],
)
def test_the_offending_key_is_named(written, old, new, message):
    assert old in NATIVE
    with pytest.raises(CalibrationKeyError, match=message) as refused:
        read_calibration(written(NATIVE.replace(old, new)))
    assert "\n" not in str(refused.value)


BOMB = "a: &a [x, x]\n" + "".join(
    f"{chr(98 + i)}: &{chr(98 + i)} [*{chr(97 + i)}, *{chr(97 + i)}]\n" for i in range(20)
)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (BOMB, "anchors and aliases .line 1. are not allowed"),
        ("a: *nothing\n", "anchors and aliases"),
        ("a: !!python/object:os.system {}\n", "the tag on line 1 is not allowed"),
        ("[" * 100_000, "nested deeper than 12 levels"),
        ("- " * 100_000, "nested deeper than 12 levels"),
        ("- 1\n" * 20_000, "more than 10000 values"),
        ("a: 1\na: 2\n", "on line 2"),
        ("a: [1, 2\n", "on line 2"),
        ("a: 1\n---\nb: 2\n", "found another document on line 2"),
        (b"\x89PNG\r\n\x1a\n\xff\xfe", "byte 0 is not UTF-8 text"),
        (b"a: \x00\n", "special characters are not allowed"),
        ("a: " + "9" * 100_000, "Exceeds the limit"),
    ],
)
def test_hostile_yaml_is_refused_in_one_short_line(written, content, message):
    with pytest.raises(CalibrationYamlError, match=message) as refused:
        read_calibration(written(content))
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < 250


def test_a_huge_file_is_refused_by_its_size_and_costs_no_memory(written):
    path = written(b"a: 1\n" * 2_000_000)
    tracemalloc.start()
    with pytest.raises(CalibrationSizeError, match="larger than 1000000 bytes"):
        read_calibration(path)
    peak_bytes = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak_bytes < 8_000_000


def test_a_number_beyond_floats_is_refused(written):
    with pytest.raises(StoneError, match="ego_from_lidar"):
        read_calibration(written(NATIVE.replace("[0.2, 0, 1.1]", f"[0.2, 0, {'9' * 400}]")))


@pytest.mark.parametrize(
    ("content", "looks_like"),
    [
        ("image_width: 640\nimage_height: 480\n", "a camera_info file without its camera_matrix"),
        ('[{"token": "a", "channel": "b", "modality": "c"}]', "a nuScenes sensor table without its calibrated_sensor"),
        ("[1, 2]", "a list"),
        ("1: 2", "another YAML file .a key is not text"),
        ("<html>", "plain text"),
        ("", "an empty file"),
        ("colour: red\n", "another YAML file"),
    ],
)
def test_another_format_is_named_and_refused(written, content, looks_like):
    with pytest.raises(CalibrationFormatError, match=f"looks like {looks_like}"):
        read_calibration(written(content))


def test_a_channel_given_twice_is_refused(written):
    with pytest.raises(CalibrationYamlError, match='found duplicate key "INS"'):
        read_calibration(written(NATIVE + "  INS: {kind: ins}\n"))
    assert issubclass(RepeatedSensorError, StoneError)


def test_refusals_survive_the_way_between_processes():
    for leaf in (CalibrationKeyError("a", "b", "c", 1), CalibrationFormatError("a", "b"), MirrorError("a", -1.0)):
        copy = pickle.loads(pickle.dumps(leaf))
        assert (type(copy), str(copy)) == (type(leaf), str(leaf))
