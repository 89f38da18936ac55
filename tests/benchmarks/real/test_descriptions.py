"""Descriptions of real recordings: what is refused, where files are looked for, what is said where there is nothing."""

from pathlib import Path
from typing import Any

import pytest

from benchmarks.real.__main__ import described_recordings, main
from benchmarks.real.description import OURS, Described, described_in, own_descriptions, read_description
from benchmarks.real.errors import DescriptionError, NothingDescribedError
from benchmarks.real.opening import classes_of, opened
from services.ingest.pipeline import SynchroniseOptions
from stone_recordings.calibrations.errors import CalibrationYamlError
from stone_recordings.calibrations.file import read_calibration
from testing.field_data import VARIABLE

RUN = "stone_real: 1\nname: yard\nabout: a yard\ncalibration: rig.yaml\nrecording: yard.mcap\n"
SCAN = RUN.replace("recording: yard.mcap", "scan: yard.bin")


def written(folder: Path, text: str, name: str = "yard") -> Path:
    path = folder / f"{name}.real.yaml"
    path.write_text(text)
    return path


def read(folder: Path, text: str) -> Described:
    return read_description(written(folder, text), folder)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (RUN + "scan: yard.bin\n", "give either `recording`, a bag, or `scan`"),
        (RUN.replace("recording: yard.mcap\n", ""), "give either `recording`, a bag, or `scan`"),
        (RUN + "tracks_m: {on: [[0, 0], [1, 0]]}\n", "`tracks_m` is for a scan"),
        (SCAN + "tracks_m: {on: [[0, 0]]}\n", "tracks_m.on: "),
        (RUN + "flat_m: [[[0, 0], [1, 0]]]\n", "flat_m.0: "),
        (RUN + "walls_m: [[[0, .nan], [1, 0]]]\n", "walls_m.0.0.1: "),
        (RUN + "walls_m: [[[0, 1e9], [1, 0]]]\n", "walls_m.0.0.1: "),
        (RUN + "flat_beside_track_m: 400\n", "flat_beside_track_m: "),
        (RUN + "passes: [thirds]\n", "passes.0: "),
        (RUN + "walls: []\n", "walls: Extra inputs"),
        (RUN.replace("yard\nabout", "../yard\nabout"), "name: "),
        (RUN.replace("real: 1", "real: 2"), "stone_real: "),
        (RUN + "semantics: {scans: [], ground: {grass: 3}, obstacle: {tree: 4}}\n", "semantics.scans: "),
        (
            RUN + "semantics: {scans: [{points: a, labels: b}], ground: {grass: 3}, obstacle: {tree: 4}}\n",
            "a needs `stamp_ns`",
        ),
        ("transforms: 1\n---\ntransforms: 2\n", "holds 2 documents"),
        ("[]", "the whole: "),
    ],
)
def test_a_description_that_cannot_be_followed_is_refused_by_field(tmp_path: Path, text: str, problem: str) -> None:
    with pytest.raises(DescriptionError) as refused:
        read(tmp_path, text)
    assert problem in str(refused.value)
    assert str(refused.value).startswith("yard.real.yaml: ")


def test_what_is_no_yaml_or_too_large_is_refused(tmp_path: Path) -> None:
    with pytest.raises(CalibrationYamlError):
        read(tmp_path, "name: [")
    with pytest.raises(DescriptionError, match="at most 1000000"):
        read(tmp_path, RUN + "#" * 1_000_000)


def test_files_are_looked_for_beside_the_description_then_in_the_folder(tmp_path: Path) -> None:
    described = read_description(written(tmp_path, RUN), tmp_path / "recordings")
    assert described.source == tmp_path / "recordings" / "yard.mcap"
    (tmp_path / "yard.mcap").touch()
    assert described.source == tmp_path / "yard.mcap"


def test_a_description_whose_recording_is_missing_is_wrong_and_so_are_two_of_one_name(tmp_path: Path) -> None:
    written(tmp_path, RUN)
    with pytest.raises(DescriptionError, match=r"yard\.mcap is not there"):
        described_in(tmp_path)
    (tmp_path / "yard.mcap").touch()
    assert [one.description.name for one in described_in(tmp_path)] == ["yard"]
    written(tmp_path, RUN, "z")
    with pytest.raises(DescriptionError, match=r"z\.real\.yaml: is called 'yard', and so is .*yard\.real\.yaml"):
        described_in(tmp_path)


def test_the_projects_own_descriptions_can_be_read_and_so_can_their_calibrations(tmp_path: Path) -> None:
    assert len(own_descriptions()) >= 2
    for path in own_descriptions():
        described = read_description(path, tmp_path)
        read_calibration(described.file(described.description.calibration))


def test_a_folder_that_was_named_and_holds_nothing_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for folder in (tmp_path, tmp_path / "none", OURS):
        with pytest.raises(NothingDescribedError, match=str(folder)):
            described_recordings(folder)
        monkeypatch.setattr("sys.argv", ["real", str(folder)])
        with pytest.raises(SystemExit) as end:
            main()
        assert str(end.value.code).startswith("nothing_described: ")
    monkeypatch.setenv(VARIABLE, str(tmp_path))
    with pytest.raises(NothingDescribedError):
        described_recordings(None)
    assert capsys.readouterr().out == ""


def test_where_nobody_named_a_folder_its_absence_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    monkeypatch.setattr("testing.field_data.ROOT", tmp_path / "project")
    assert described_recordings(None) == []
    assert VARIABLE in capsys.readouterr().out


@pytest.mark.parametrize("content", [b"", b"\0" * 17, b"\0\0\xc0\x7f" * 4])
def test_a_scan_that_is_none_is_refused(tmp_path: Path, content: bytes) -> None:
    described = read(tmp_path, SCAN)
    (tmp_path / "rig.yaml").write_text(RIG)
    with pytest.raises(DescriptionError, match="is not there"):
        opened(described, SynchroniseOptions())
    (tmp_path / "yard.bin").write_bytes(content)
    with pytest.raises(DescriptionError, match=r"multiple of 16|not finite"):
        opened(described, SynchroniseOptions())


def test_classes_of_another_scan_are_refused(tmp_path: Path) -> None:
    described = read(tmp_path, SCAN)
    (tmp_path / "yard.bin").write_bytes(b"\0\0\x80\x3f" * 8)
    with pytest.raises(DescriptionError, match="is not there"):
        classes_of(described, "yard.bin", "yard.label")
    (tmp_path / "yard.label").write_bytes(b"\0" * 12)
    with pytest.raises(DescriptionError, match="3 classes for 2 points"):
        classes_of(described, "yard.bin", "yard.label")


RIG: Any = """stone_calibration: 1
name: rig
ego_from_lidar: {translation_m: [0, 0, 1], rotation_wxyz: [1, 0, 0, 0]}
sensors: {}
"""
