"""Hostile zips and folders: nothing is unpacked, nothing leads anywhere, and what is read is bounded."""

import io
import pickle
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stone.errors import Refused, StoneError
from stone.sensors.calibration import Box, Footprint
from stone_files.calibration_bundle import SIZE_LIMIT_BYTES, read_bundle
from stone_recordings.calibrations.errors import CalibrationYamlError, bad_calibration_key
from stone_recordings.calibrations.file import read_any_calibration, read_calibration
from stone_recordings.calibrations.recognition import unknown_calibration_format
from testing.refusals import refused_as
from tests.stone_recordings.calibrations import robots


def zipped(*members: tuple[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", method) as archive:
        for name, content in members:
            archive.writestr(name, content)
    return packed.getvalue()


def refused(tmp_path: Path, content: bytes, leaf: str) -> None:
    path = tmp_path / "rig.zip"
    path.write_bytes(content)
    with refused_as(leaf) as reason:
        read_any_calibration(path)
    assert "\n" not in str(reason.value)
    assert len(str(reason.value)) < 300


@pytest.mark.parametrize(
    "name", ["../../etc/x.yaml", "/etc/x.yaml", "a/../../x.yaml", "a\\..\\x.yaml", "a\x1b[2J.yaml"]
)
def test_a_name_that_leads_out_is_refused(tmp_path: Path, name: str) -> None:
    refused(tmp_path, zipped((name, b"a: 1")), "CAL-428")
    assert [file.name for file in tmp_path.iterdir()] == ["rig.zip"]


def test_a_zip_bomb_costs_what_is_allowed(tmp_path: Path) -> None:
    bomb = zipped(("a.yaml", b" " * 100_000_000))
    assert len(bomb) < SIZE_LIMIT_BYTES
    tracemalloc.start()
    refused(tmp_path, bomb, "CAL-420")
    peak_bytes = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak_bytes < 8_000_000


def encrypted() -> bytes:
    content = bytearray(zipped(("a.yaml", b"a: 1")))
    content[content.index(b"PK\x01\x02") + 8] |= 1
    return bytes(content)


def damaged() -> bytes:
    content = bytearray(zipped(("a.yaml", b"a: 1\nb: 2\n"), method=zipfile.ZIP_STORED))
    content[content.index(b"b: 2")] ^= 0xFF
    return bytes(content)


@pytest.mark.filterwarnings("ignore:Duplicate name")
@pytest.mark.parametrize(
    "content",
    [
        lambda: zipped(*((f"{index}.yaml", b" " * 900_000) for index in range(6))),
        lambda: zipped(*((f"{index}.yaml", b"") for index in range(65))),
        lambda: zipped(("a.yaml", b"a: 1"), method=zipfile.ZIP_BZIP2),
        lambda: zipped(("a.yaml", b"a: 1"), method=zipfile.ZIP_LZMA),
        lambda: zipped(("inner.zip", zipped(("a.yaml", b"a: 1")))),
        lambda: zipped(("a.yaml", b"a: 1"), ("a.yaml", b"a: 2")), encrypted, damaged,
    ],
    ids=["together too large", "65 files", "BZIP2", "LZMA", "a zip in a zip", "one name twice", "encrypted", "damaged"],
)  # fmt: skip
def test_a_zip_that_is_no_bundle_is_refused(tmp_path: Path, content: Callable[[], bytes]) -> None:
    refused(tmp_path, content(), "CAL-428")


@settings(max_examples=80)
@given(st.data())
def test_no_damage_to_a_zip_is_more_than_a_refusal(tmp_path_factory, data):
    whole = bytearray(zipped(("a.yaml", b"image_width: 1\n"), ("b.json", b"[]")))
    for place, value in data.draw(st.lists(st.tuples(st.integers(0, len(whole) - 1), st.integers(0, 255)), max_size=8)):
        whole[place] = value
    path = tmp_path_factory.getbasetemp() / "damaged.zip"
    path.write_bytes(bytes(whole[: data.draw(st.integers(0, len(whole)))]))
    with pytest.raises(StoneError):
        read_any_calibration(path)


def test_what_is_no_calibration_is_left_aside_and_named(tmp_path: Path) -> None:
    read = read_any_calibration(robots.write(tmp_path / "mule", robots.kalibr()))
    assert [(finding.code, finding.severity) for finding in read.findings] == [("CAL-436", "info"), ("CAL-431", "info")]
    assert "report.txt" in read.findings[1].message


def test_links_in_a_folder_are_not_followed(tmp_path: Path) -> None:
    secret = tmp_path / "secret.yaml"
    secret.write_text("key: hunter2")
    folder = robots.write(tmp_path / "mule", robots.ros_matrices())
    (folder / "link.yaml").symlink_to(secret)
    assert "link.yaml" not in [name for name, _ in read_bundle(folder).documents]


def test_a_folder_that_is_a_whole_disk_is_refused(tmp_path: Path) -> None:
    folder = tmp_path / "disk"
    folder.mkdir()
    for index in range(1001):
        (folder / f"{index}.bin").touch()
    with refused_as("CAL-428"):
        read_any_calibration(folder)


@pytest.mark.parametrize(
    "content",
    [
        b"[" * 50_000 + b"]" * 50_000,
        b'{"a":' * 50_000 + b"1" + b"}" * 50_000,
        b"[" + b"1," * 40_000 + b"1]",
        b'{"stone_calibration": 1, "name": "a", "name": "b"}',
    ],
)
def test_hostile_json_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "rig.json"
    path.write_bytes(content)
    with pytest.raises(CalibrationYamlError):
        read_any_calibration(path)


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


def test_a_file_may_leave_parts_out_and_the_shipped_example_leaves_none(written):
    text = "stone_calibration: 1\nname: a\nego_from_lidar: {translation_m: [0, 0, 1], rotation_wxyz: [1, 0, 0, 0]}\n"
    calibration, findings = read_calibration(written(text))
    assert (calibration.footprint, calibration.mounts) == (Footprint(), ())
    assert [(finding.code, finding.severity) for finding in findings] == [("CAL-436", "info")]
    assert read_calibration(written(text + "footprint: {length_m: 1.06, width_m: 0.85}\n"))[1] == ()
    calibration, findings = read_calibration(Path(__file__).parents[3] / "examples" / "kitti0005.calibration.yaml")
    assert findings == ()
    assert calibration.footprint == Footprint(3.0, 1.6)


def test_what_the_checks_refuse_is_refused_from_a_file(written):
    with refused_as("CAL-408", match="RADAR_LEFT") as refused:
        read_calibration(written(NATIVE.replace("[0, -1, 0], [1, 0, 0], [0, 0, 1]", "[0, 1, 0], [1, 0, 0], [0, 0, 1]")))
    assert "\n" not in str(refused.value)
    with refused_as("CAL-410", match="CAM_FRONT"):
        read_calibration(written(NATIVE.replace(", 0.01]", "]")))
    with refused_as("CAL-416", match="INS"):
        read_calibration(written(NATIVE.replace("0, -0.5]", "0, .nan]").replace("1, -0.5]", "1, .nan]")))
    with pytest.raises(StoneError, match="ego_from_lidar"):
        read_calibration(written(NATIVE.replace("[0.2, 0, 1.1]", f"[0.2, 0, {'9' * 400}]")))
    with pytest.raises(CalibrationYamlError):
        read_calibration(written(NATIVE + "  INS: {kind: ins}\n"))


def test_what_was_mended_is_said_and_refusals_survive_the_way_between_processes(written):
    _, findings = read_calibration(written(NATIVE.replace("[0, -1, 0], [1, 0, 0]", "[0.001, -1, 0], [1, 0, 0]")))
    assert [(f.code, f.severity, f.topic) for f in findings] == [("CAL-401", "warning", "RADAR_LEFT")]
    for leaf in (bad_calibration_key("a", "b", "c", 1), unknown_calibration_format("a", "b"), Refused("CAL-408", "a")):
        copy = pickle.loads(pickle.dumps(leaf))
        assert (type(copy), str(copy)) == (type(leaf), str(leaf))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("lidar_from_sensor: {matrix", "sensor_from_lidar: {matrix", r"sensors\.INS\.lidar_from_sensor: "),
        ("width_m: 0.85", "width: 0.85", r"footprint\.width_m: "),
        ("name: stone-sim", "name: stone-sim\nextra: 1", r"extra: "),
        ("[0.2, 0, 1.1]", "[0.2, 0]", r"ego_from_lidar\.translation_m: "),
        ("[0.2, 0, 1.1]", "[0.2, 0, '1.1']", r"translation_m\.2: "),
        ("[0.2, 0, 1.1]", "[0.2, 0, true]", r"translation_m\.2: "),
        ("rotation_wxyz: [1, 0, 0, 0]}", "matrix: [[1]]}", r"ego_from_lidar\.matrix"),
        (", rotation_wxyz: [1, 0, 0, 0]}", "}", r"ego_from_lidar: "),
        ("stone_calibration: 1", "stone_calibration: 2", r"stone_calibration: "),
        ("-1500", "1.5", r"sensors\.CAM_FRONT\.time_offset_ns: "),
        ("width_px: 1920", "width_px: -1", r"intrinsics\.width_px: "),
    ],
)
def test_the_offending_key_is_named(written, old, new, message):
    assert old in NATIVE
    with refused_as("CAL-422", match=message) as refused:
        read_calibration(written(NATIVE.replace(old, new)))
    assert "\n" not in str(refused.value)


BOMB = "a: &a [x, x]\n" + "".join(
    f"{chr(98 + i)}: &{chr(98 + i)} [*{chr(97 + i)}, *{chr(97 + i)}]\n" for i in range(20)
)


@pytest.mark.parametrize(
    "content",
    [
        BOMB, "a: *nothing\n", "a: !!python/object:os.system {}\n", "[" * 100_000, "- " * 100_000, "- 1\n" * 20_000,
        "a: 1\na: 2\n", "a: [1, 2\n", "a: 1\n---\nb: 2\n", b"\x89PNG\r\n\x1a\n\xff\xfe", b"a: \x00\n",
        "a: " + "9" * 100_000,
    ],
)  # fmt: skip
def test_hostile_yaml_is_refused_in_one_short_line(written, content):
    with pytest.raises(CalibrationYamlError) as refused:
        read_calibration(written(content))
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < 250


def test_a_huge_file_is_refused_by_its_size_and_costs_no_memory(written):
    path = written(b"a: 1\n" * 2_000_000)
    tracemalloc.start()
    with refused_as("CAL-420"):
        read_calibration(path)
    peak_bytes = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak_bytes < 8_000_000


@pytest.mark.parametrize(
    "content",
    [
        "image_width: 640\nimage_height: 480\n", '[{"token": "a", "channel": "b", "modality": "c"}]', "[1, 2]",
        "1: 2", "<html>", "", "colour: red\n",
    ],
)  # fmt: skip
def test_another_format_is_named_and_refused(written, content):
    with refused_as("CAL-423"):
        read_calibration(written(content))
