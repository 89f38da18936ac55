"""`stone export` on labels of this machine: what it prints, and what it refuses by code."""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner, Result

from stone_client.main import app
from tests.services.labeler.exports.made import Labelled


def run(*words: str | Path) -> Result:
    return CliRunner().invoke(app, ["export", *(str(word) for word in words)])


def refusal(result: Result) -> dict[str, Any]:
    """The one finding of a refusal, said on stderr and on stdout alike."""
    assert result.exit_code == 1, result.output
    (finding,) = json.loads(result.stdout)["findings"]
    assert result.stderr.startswith(f"{finding['code']}: ")
    return dict(finding)


@pytest.fixture
def copy(drive: Labelled, tmp_path: Path) -> Path:
    """The labels, to be damaged; their recording stays where it is."""
    return Path(shutil.copytree(drive.folder, tmp_path / "labels"))


def test_what_was_written_is_told_and_that_nothing_changed(copy: Path, tmp_path: Path) -> None:
    result = run(copy, "--format", "mesh", "-o", tmp_path / "new" / "out", "--json")
    record = json.loads(result.stdout)
    assert (record["status"], record["format"], record["sequences"]) == ("written", "mesh", ["drive"])
    assert record["output"] == str(tmp_path / "new" / "out")
    held = [path for path in (tmp_path / "new" / "out" / "drive").iterdir()]
    assert record["files"] == len(held)
    assert record["size_bytes"] == sum(path.stat().st_size for path in held)
    again = run(copy, "--format", "mesh", "-o", tmp_path / "new" / "out", "--json")
    assert (again.exit_code, json.loads(again.stdout)["status"]) == (0, "unchanged")
    assert run(copy, "--format", "mesh").exit_code == 0
    assert (copy.parent / "labels-mesh" / "drive" / "mesh.glb").is_file()


@pytest.mark.parametrize(
    ("folder", "form", "gone", "code"),
    [
        ("nothing", "mesh", "", "not_labels"),
        ("labels", "mesh", "source.json", "recording_gone"),
    ],
)
def test_what_cannot_be_exported_is_refused(
    copy: Path, tmp_path: Path, folder: str, form: str, gone: str, code: str
) -> None:
    (tmp_path / "nothing").mkdir()
    if gone:
        (copy / gone).unlink()
    assert refusal(run(tmp_path / folder, "--format", form, "--json"))["code"] == code


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("report.json", b"{"),
        ("report.json", b"[1]"),
        ("report.json", b"\xff\xfe"),
        ("sequence.npz", b"PK\3\4 not a zip"),
        ("sequence.npz", b""),
        ("source.json", b"{"),
        ("source.json", b"[1]"),
    ],
)
def test_damaged_labels_are_refused(copy: Path, name: str, content: bytes) -> None:
    (copy / name).write_bytes(content)
    assert refusal(run(copy, "--format", "mesh", "--json"))["code"] == "damaged_labels"


def test_a_recording_that_is_gone_is_refused_and_found_again(copy: Path, drive: Labelled, tmp_path: Path) -> None:
    (copy / "source.json").write_text(json.dumps({"recording": str(tmp_path / "gone.mcap")}))
    found = refusal(run(copy, "--format", "mesh", "--json"))
    assert found["code"] == "recording_gone"
    assert "--bag" in found["message"]
    assert run(copy, "--format", "mesh", "--bag", drive.bag).exit_code == 0


def test_a_recording_that_is_another_is_refused(copy: Path, drive: Labelled, tmp_path: Path) -> None:
    content = bytearray(drive.bag.read_bytes())
    content[len(content) // 2] ^= 1
    (tmp_path / "drive.mcap").write_bytes(content)
    found = refusal(run(copy, "--format", "mesh", "--bag", tmp_path / "drive.mcap", "--json"))
    assert found["code"] == "recording_changed"
    assert not (tmp_path / "labels-mesh").exists()


def test_a_damaged_frame_is_refused_and_leaves_no_folder(copy: Path) -> None:
    next((copy / "gts" / "drive").iterdir()).joinpath("labels.npz").write_bytes(b"PK\3\4")
    assert refusal(run(copy, "--format", "kitti", "--json"))["code"] == "damaged_labels"
    assert [path.name for path in copy.parent.iterdir()] == ["labels"]
