"""An exported folder: whole or absent, not written again when nothing changed, and open to further sequences."""

import hashlib
import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from services.labeler.exports.folder import ExportOutcome, ExportRequest, export
from services.labeler.exports.source import LabelledSequence
from stone.sensors.sequence import frame_token
from testing.refusals import refused_as
from tests.services.labeler.exports.made import Labelled, files_of, unheard

SHIFT_NS = 3_600_000_000_000


def exported(drive: Labelled, out: Path, name: str = "drive", format_name: str = "nuscenes") -> ExportOutcome:
    report = {**drive.report, "sequence": name}
    return export(ExportRequest(format_name, out, report), lambda: renamed(drive, name), unheard)


def renamed(drive: Labelled, name: str) -> LabelledSequence:
    """The drive as if it had been another one: an hour later for every other name."""
    source = drive.source()
    if name == "drive":
        return source
    frames = source.sequence.frames
    stamps_ns = frames.stamps_ns + SHIFT_NS
    tokens = tuple(frame_token(name, int(stamp)) for stamp in stamps_ns)
    moved = replace(frames, stamps_ns=stamps_ns, tokens=tokens)
    assert source.sequence.track is not None
    track = replace(source.sequence.track, stamps_ns=source.sequence.track.stamps_ns + SHIFT_NS)
    return replace(source, sequence=replace(source.sequence, name=name, frames=moved, track=track))


def never() -> LabelledSequence:
    raise AssertionError("the labels were opened")


def table(out: Path, name: str) -> Any:
    return json.loads((out / "v1.0-trainval" / f"{name}.json").read_text())


def test_an_unchanged_sequence_is_not_even_opened_and_other_parameters_replace_it(
    drive: Labelled, tmp_path: Path
) -> None:
    assert exported(drive, tmp_path / "out", format_name="mesh").status == "written"
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "out").rglob("*")}
    slower = {**drive.report, "cpu_s": 1e6, "stages_wall_s": {}}
    for report in (drive.report, slower):
        assert export(ExportRequest("mesh", tmp_path / "out", report), never, unheard).status == "unchanged"
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "out").rglob("*")} == before
    other = {**drive.report, "parameters": {"profile": "paper"}}
    again = export(ExportRequest("mesh", tmp_path / "out", other), drive.source, unheard)
    assert (again.status, again.sequences) == ("replaced", ("drive",))


@pytest.fixture(scope="module")
def both(drive: Labelled, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("both") / "out"
    exported(drive, out)
    assert exported(drive, out, "later").status == "added"
    return out


def test_a_second_sequence_joins_without_rewriting_the_first(drive: Labelled, tmp_path: Path) -> None:
    exported(drive, tmp_path / "out")
    first = {path.name: path.stat().st_ino for path in (tmp_path / "out" / "samples" / "LIDAR_TOP").iterdir()}
    outcome = exported(drive, tmp_path / "out", "later")
    both = {path.name: path.stat().st_ino for path in (tmp_path / "out" / "samples" / "LIDAR_TOP").iterdir()}
    assert outcome.sequences == ("drive", "later")
    assert len(both) == 2 * len(first)
    assert {name: both[name] for name in first} == first


def test_tables_of_both_are_joined_and_shared_rows_stand_once(drive: Labelled, both: Path) -> None:
    count = len(drive.source().sequence.frames)
    assert [scene["name"] for scene in table(both, "scene")] == ["drive", "later"]
    assert len(table(both, "sample")) == 2 * count
    assert len(table(both, "log")) == len(table(both, "map")) == 2
    assert len(table(both, "sensor")) == 10
    assert len(table(both, "calibrated_sensor")) == 20
    assert len(table(both, "category")) == 4
    for name in ("sample_data", "ego_pose", "calibrated_sensor"):
        tokens = [row["token"] for row in table(both, name)]
        assert len(set(tokens)) == len(tokens)
    assert json.loads((both / "v1.0-trainval" / "splits.json").read_text()) == {"all": ["drive", "later"]}


def test_the_order_in_which_sequences_come_changes_nothing(drive: Labelled, both: Path, tmp_path: Path) -> None:
    exported(drive, tmp_path / "out", "later")
    exported(drive, tmp_path / "out")
    other, expected = files_of(tmp_path / "out"), files_of(both)
    assert other.pop("export.json") != expected.pop("export.json")  # numbers count arrivals
    assert other == expected


def test_checksums_are_those_of_the_files(both: Path) -> None:
    for name in ("drive", "later"):
        lines = (both / "checksums" / f"{name}.sha256").read_text().splitlines()
        assert len(lines) > 60
        for line in lines:
            digest, _, path = line.partition("  ")
            assert hashlib.sha256((both / path).read_bytes()).hexdigest() == digest


def test_kitti_counts_sequences(drive: Labelled, tmp_path: Path) -> None:
    exported(drive, tmp_path / "out", format_name="kitti")
    exported(drive, tmp_path / "out", "later", "kitti")
    assert {path.name for path in (tmp_path / "out" / "dataset" / "sequences").iterdir()} == {"00", "01"}
    config = (tmp_path / "out" / "semantic-kitti-stone.yaml").read_text()
    assert "train: [0, 1]" in config
    assert "1: 'later'" in config


def test_one_recording_under_two_names_is_refused_and_nothing_is_lost(drive: Labelled, tmp_path: Path) -> None:
    exported(drive, tmp_path / "out")
    before = files_of(tmp_path / "out")
    twin = replace(drive.source(), sequence=replace(drive.source().sequence, name="twin"))
    request = ExportRequest("nuscenes", tmp_path / "out", {**drive.report, "sequence": "twin"})
    with refused_as("export_clash"):
        export(request, lambda: twin, unheard)
    assert files_of(tmp_path / "out") == before
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_an_export_that_fails_leaves_nothing(drive: Labelled, tmp_path: Path) -> None:
    def breaks(done: int, _total: int) -> None:
        if done == 3:
            raise RuntimeError("the disk is full")

    with pytest.raises(RuntimeError, match="the disk is full"):
        export(ExportRequest("nuscenes", tmp_path / "out", drive.report), drive.source, breaks)
    assert list(tmp_path.iterdir()) == []


def test_other_peoples_folders_and_formats_are_left_alone(drive: Labelled, tmp_path: Path) -> None:
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "thesis.tex").write_text("years")
    with refused_as("output_exists"):
        exported(drive, tmp_path / "home", format_name="mesh")
    exported(drive, tmp_path / "mesh", format_name="mesh")
    with refused_as("not_an_export"):
        exported(drive, tmp_path / "mesh", format_name="kitti")
    with refused_as("unknown_format"):
        exported(drive, tmp_path / "new", format_name="waymo")


ENTRY = '{"format": "mesh", "sequences": {%s}}'


@pytest.mark.parametrize(
    "manifest",
    [
        "",
        "[]",
        '{"format": "mesh"}',
        ENTRY % '"a": {"x": 1}',
        ENTRY % '"../x": {"recipe": "", "frames": 1, "number": 0}',
        ENTRY % '"x": {"recipe": "", "frames": 1, "number": "/"}',
    ],
)
def test_a_manifest_that_is_damaged_or_leads_elsewhere_is_refused(
    drive: Labelled, tmp_path: Path, manifest: str
) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "export.json").write_text(manifest)
    with refused_as("not_an_export"):
        exported(drive, tmp_path / "out", format_name="mesh")


@pytest.mark.parametrize("name", ["../elsewhere", "", None])
def test_a_report_that_names_no_plain_sequence_is_refused(drive: Labelled, tmp_path: Path, name: object) -> None:
    with refused_as("damaged_labels"):
        export(ExportRequest("mesh", tmp_path / "out", {**drive.report, "sequence": name}), drive.source, unheard)
    with refused_as("damaged_labels"):
        export(ExportRequest("mesh", tmp_path / "out", {**drive.report, "sequence": "other"}), drive.source, unheard)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("line", ["0" * 64 + "  ../secret\n", "0" * 64 + "  /etc/passwd\n", "0" * 64 + "  gone\n"])
def test_checksums_that_name_other_files_are_refused(drive: Labelled, tmp_path: Path, line: str) -> None:
    exported(drive, tmp_path / "out", format_name="mesh")
    (tmp_path / "out" / "checksums" / "drive.sha256").write_text(line)
    (tmp_path / "secret").write_text("key")
    with refused_as("not_an_export"):
        exported(drive, tmp_path / "out", "later", "mesh")


def test_files_are_copied_where_links_cannot_be(
    drive: Labelled, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_links(*_: object, **__: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    exported(drive, tmp_path / "out", format_name="mesh")
    shutil.copytree(tmp_path / "out", tmp_path / "linked")
    exported(drive, tmp_path / "linked", "later", "mesh")
    monkeypatch.setattr("os.link", no_links)
    exported(drive, tmp_path / "out", "later", "mesh")
    assert files_of(tmp_path / "out") == files_of(tmp_path / "linked")
