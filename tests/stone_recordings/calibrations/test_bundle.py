"""Hostile zips and folders: nothing is unpacked, nothing leads anywhere, and what is read is bounded."""

import io
import tracemalloc
import zipfile
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stone.errors import StoneError
from stone_files.calibration_bundle import SIZE_LIMIT_BYTES, read_bundle
from stone_files.errors import CalibrationBundleError, CalibrationSizeError
from stone_recordings.calibrations.errors import CalibrationYamlError
from stone_recordings.calibrations.file import read_any_calibration
from tests.stone_recordings.calibrations import robots


def zipped(*members: tuple[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", method) as archive:
        for name, content in members:
            archive.writestr(name, content)
    return packed.getvalue()


def refused(tmp_path: Path, content: bytes, leaf: type[StoneError], match: str) -> None:
    path = tmp_path / "rig.zip"
    path.write_bytes(content)
    with pytest.raises(leaf, match=match) as reason:
        read_any_calibration(path)
    assert "\n" not in str(reason.value)
    assert len(str(reason.value)) < 300


@pytest.mark.parametrize(
    "name", ["../../etc/x.yaml", "/etc/x.yaml", "a/../../x.yaml", "a\\..\\x.yaml", "a\x1b[2J.yaml"]
)
def test_a_name_that_leads_out_is_refused(tmp_path: Path, name: str) -> None:
    refused(tmp_path, zipped((name, b"a: 1")), CalibrationBundleError, "which leads outside the bundle")
    assert [file.name for file in tmp_path.iterdir()] == ["rig.zip"]


def test_a_zip_bomb_costs_what_is_allowed(tmp_path: Path) -> None:
    bomb = zipped(("a.yaml", b" " * 100_000_000))
    assert len(bomb) < SIZE_LIMIT_BYTES
    tracemalloc.start()
    refused(tmp_path, bomb, CalibrationSizeError, "larger than 1000000 bytes")
    peak_bytes = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak_bytes < 8_000_000


def test_many_files_that_are_allowed_alone_are_not_together(tmp_path: Path) -> None:
    big = zipped(*((f"{index}.yaml", b" " * 900_000) for index in range(6)))
    refused(tmp_path, big, CalibrationBundleError, "together are larger than 4000000 bytes")


def test_more_files_than_a_rig_has_are_refused(tmp_path: Path) -> None:
    refused(tmp_path, zipped(*((f"{index}.yaml", b"") for index in range(65))), CalibrationBundleError, "65 files")


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_a_packing_that_may_ask_for_gigabytes_is_refused(tmp_path: Path, method: int) -> None:
    refused(tmp_path, zipped(("a.yaml", b"a: 1"), method=method), CalibrationBundleError, "compressed by method")


def test_an_encrypted_member_is_refused(tmp_path: Path) -> None:
    content = bytearray(zipped(("a.yaml", b"a: 1")))
    content[content.index(b"PK\x01\x02") + 8] |= 1
    refused(tmp_path, bytes(content), CalibrationBundleError, "encrypted")


def test_a_zip_in_a_zip_is_left_aside(tmp_path: Path) -> None:
    inner = zipped(("a.yaml", b"a: 1"))
    refused(tmp_path, zipped(("inner.zip", inner)), CalibrationBundleError, "no .yaml, .yml or .json file")


def test_two_members_of_one_name_are_refused(tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match="Duplicate name"):
        content = zipped(("a.yaml", b"a: 1"), ("a.yaml", b"a: 2"))
    refused(tmp_path, content, CalibrationBundleError, "two files in it have the same name")


def test_a_damaged_member_is_refused(tmp_path: Path) -> None:
    content = bytearray(zipped(("a.yaml", b"a: 1\nb: 2\n"), method=zipfile.ZIP_STORED))
    content[content.index(b"b: 2")] ^= 0xFF
    refused(tmp_path, bytes(content), CalibrationBundleError, "the zip is damaged .Bad CRC-32")


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_no_damage_to_a_zip_is_more_than_a_refusal(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
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
    with pytest.raises(CalibrationBundleError, match="more than 1000 entries"):
        read_any_calibration(folder)


@pytest.mark.parametrize(
    ("content", "match"),
    [
        (b"[" * 50_000 + b"]" * 50_000, "nested deeper than 12 levels"),
        (b'{"a":' * 50_000 + b"1" + b"}" * 50_000, "nested deeper than 12 levels"),
        (b"[" + b"1," * 40_000 + b"1]", "more than 10000 values"),
        (b'{"stone_calibration": 1, "name": "a", "name": "b"}', "the key 'name' is given twice"),
    ],
)
def test_hostile_json_is_refused(tmp_path: Path, content: bytes, match: str) -> None:
    path = tmp_path / "rig.json"
    path.write_bytes(content)
    with pytest.raises(CalibrationYamlError, match=match):
        read_any_calibration(path)
