"""`stone check` says what a dataset holds, or what is wrong with it."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from stone.labels.grid import GRID_SHAPE
from stone_client.main import app
from stone_files.npz import npz_bytes
from testing.worlds.published_datasets import (
    VERSION,
    SyntheticDataset,
    made_labels,
    write_published,
    write_published_tar,
)

WHAT = SyntheticDataset(labels=(made_labels(),), splits={"train": ["field-0000"]})


def run(*words: str | Path) -> Result:
    return CliRunner().invoke(app, [str(word) for word in words])


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    return write_published(tmp_path / "dataset", WHAT)


def test_a_sound_dataset_is_shown(dataset: Path) -> None:
    found = run("check", dataset)
    assert found.exit_code == 0, found.stderr
    assert "release layout, 2 sequences, 6 frames" in found.stdout
    for word in ("field-0001", "train", "LIDAR_TOP", "T of the occupied voxels", "frames with mask_camera"):
        assert word in found.stdout


def test_a_folder_and_a_tar_give_the_same_record(dataset: Path, tmp_path: Path) -> None:
    in_tar = run("check", write_published_tar(tmp_path / "dataset.tar", WHAT, "top/"), "--json")
    in_folder = run("check", dataset, "--json")
    assert in_folder.exit_code == in_tar.exit_code == 0
    assert json.loads(in_folder.stdout) == json.loads(in_tar.stdout)
    assert json.loads(in_folder.stdout)["frames"] == 6


def test_every_fault_is_a_line_and_the_exit_code_is_one(dataset: Path) -> None:
    path = dataset / VERSION / "ego_pose.json"
    rows = json.loads(path.read_text())
    for row in rows[:3]:
        row["rotation"] = [2, 0, 0, 0]
    path.write_text(json.dumps(rows))
    found = run("check", dataset, "--faults", "2", "--json")
    assert found.exit_code == 1
    lines = found.stderr.splitlines()
    assert [line.partition(":")[0] for line in lines if line.startswith("DST")] == ["DST-022", "DST-022"]
    assert "… and 1 more" in lines
    assert "These are of its rows" in lines[-1]
    record = json.loads(found.stdout)
    assert (record["faults_total"], record["reached"]) == (3, "rows")
    assert record["faults"][0]["file"] == f"{VERSION}/ego_pose.json"
    assert [fault["row"] for fault in record["faults"]] == [1, 2]


def test_other_numbers_need_a_file_that_says_what_they_mean(dataset: Path, tmp_path: Path) -> None:
    numbers = np.full(GRID_SHAPE, 17, np.uint8)
    numbers[:, :, 9] = 11
    for path in dataset.rglob("labels.npz"):
        path.unlink()
        path.write_bytes(npz_bytes({"semantics": numbers}))
    refused = run("check", dataset)
    assert refused.exit_code == 1
    assert "DST-066" in refused.stderr
    assert "semantics has 11, 17, which 'stone' does not name (give it with --classes" in refused.stderr
    (tmp_path / "classes.yaml").write_text("name: theirs\nclasses: {11: T, 17: free}\n")
    record = json.loads(run("check", dataset, "--classes", tmp_path / "classes.yaml", "--json").stdout)
    assert record["classes"] == "theirs"
    assert record["class_share_of_occupied"] == {"T": 1, "P": 0, "N": 0}
    (tmp_path / "classes.yaml").write_text("name: theirs\nclasses: {11: grass}\n")
    assert "DST-070" in run("check", dataset, "--classes", tmp_path / "classes.yaml").stderr


def test_a_tar_that_is_none_is_refused(tmp_path: Path) -> None:
    (tmp_path / "dataset.tar").write_bytes(b"none" * 1000)
    found = run("check", tmp_path / "dataset.tar")
    assert found.exit_code == 1
    assert found.stderr.startswith("bad_tar: ")
