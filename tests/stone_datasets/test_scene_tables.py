"""Tables parted by scene: every row of a scene as it stood, and no row of another."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from shutil import copytree
from typing import Any

import pytest

from stone_datasets.reading import read_tables_of
from stone_datasets.scene_tables import TABLES, write_scene_tables, write_splits
from testing.refusals import refused_as
from testing.worlds.imported import tar_of
from testing.worlds.published_datasets import VERSION, SyntheticDataset, write_published
from tests.stone_datasets.conftest import Rows

Parts = list[Mapping[str, Rows]]
SCENES = ("field-0000", "field-0001")


def parted(folder: Path, out: Path) -> Parts:
    """What each scene gets, by table."""
    out.mkdir()
    reading = read_tables_of(tar_of(folder, out / "dataset.tar"))
    folders = [out / name for name in SCENES]
    for one in folders:
        one.mkdir()
    assert reading.placed is not None
    write_scene_tables(reading.index.files, reading.placed, folders.__getitem__)
    return [{table: json.loads((one / f"{table}.json").read_text()) for table in TABLES} for one in folders]


def rows_of(folder: Path, table: str) -> Rows:
    path = folder / VERSION / f"{table}.json"
    found: Rows = json.loads(path.read_text()) if path.exists() else []
    return found


def write(folder: Path, table: str, rows: list[Any]) -> None:
    (folder / VERSION / f"{table}.json").write_text(json.dumps(rows))


@pytest.fixture
def rich(copied: Path) -> Path:
    """The good dataset with the tables that it lacks, and one that the schema does not have."""
    logs, samples = rows_of(copied, "log"), rows_of(copied, "sample")
    write(copied, "map", [
        {"token": "both", "log_tokens": [one["token"] for one in logs], "filename": "maps/both.png"},
        {"token": "second", "log_tokens": [logs[1]["token"]], "filename": "maps/second.png"},
        {"token": "nobody's", "log_tokens": ["elsewhere"], "filename": "maps/none.png"},
        {"token": "mute", "filename": 3},
    ])  # fmt: skip
    write(copied, "instance", [{"token": "car"}, {"token": "tree"}, {"token": "nobody's"}])
    write(copied, "sample_annotation", [
        {"token": "a", "sample_token": samples[0]["token"], "instance_token": "car"},
        {"token": "b", "sample_token": samples[-1]["token"], "instance_token": "car"},
        {"token": "c", "sample_token": samples[-1]["token"], "instance_token": "tree"},
        {"token": "d", "sample_token": "elsewhere", "instance_token": "tree"},
        {"token": "e", "sample_token": ["no token"], "instance_token": None},
    ])  # fmt: skip
    write(copied, "lidarseg", [{"token": "unknown"}])
    return copied


def test_a_scene_has_every_row_of_it_once_and_in_order(rich: Path, tmp_path: Path) -> None:
    parts = parted(rich, tmp_path / "out")
    for table in ("calibrated_sensor", "ego_pose", "log", "sample", "sample_data", "scene"):
        assert [row for part in parts for row in part[table]] == rows_of(rich, table)
        assert all(part[table] for part in parts)
    first, second = parts
    tokens = {table: [[row["token"] for row in part[table]] for part in (first, second)] for table in TABLES}
    assert tokens["map"] == [["both"], ["both", "second"]]
    assert tokens["sample_annotation"] == [["a"], ["b", "c"]]
    assert tokens["instance"] == [["car"], ["car", "tree"]]
    for part in (first, second):
        assert part["category"] == rows_of(rich, "category")
        assert part["sensor"] == rows_of(rich, "sensor")
        assert part["attribute"] == part["visibility"] == []


def test_rows_keep_keys_their_order_and_numbers(copied: Path, tmp_path: Path) -> None:
    poses = rows_of(copied, "ego_pose")
    poses[0] = {"further": {"z": [1e-7, 3, -0.0], "a": "é\n"}, **dict(reversed(poses[0].items()))}
    write(copied, "ego_pose", poses)
    parted(copied, tmp_path / "out")
    text = (tmp_path / "out" / SCENES[0] / "ego_pose.json").read_text()
    assert text.startswith("[\n")
    assert text.endswith("\n]\n")
    lines = text.splitlines()[1:-1]
    assert lines[0].removesuffix(",") == json.dumps(poses[0])
    assert len(lines) == len(poses) // 2


def test_a_pose_that_two_scenes_share_goes_to_both(copied: Path, tmp_path: Path) -> None:
    data = rows_of(copied, "sample_data")
    data[-1]["ego_pose_token"] = data[0]["ego_pose_token"]
    write(copied, "sample_data", data)
    first, second = parted(copied, tmp_path / "out")
    shared = [row for row in second["ego_pose"] if row["token"] == data[0]["ego_pose_token"]]
    assert shared == [row for row in first["ego_pose"] if row["token"] == data[0]["ego_pose_token"]] != []


def test_rows_in_any_order_are_parted_alike(rich: Path, tmp_path: Path) -> None:
    mixed = copytree(rich, tmp_path / "mixed")
    for table in ("sample", "ego_pose", "sample_data"):
        write(mixed, table, rows_of(rich, table)[::-1])
    key: Callable[[Mapping[str, Any]], str] = lambda row: row["token"]  # noqa: E731
    for plain, other in zip(parted(rich, tmp_path / "a"), parted(mixed, tmp_path / "b"), strict=True):
        for table in TABLES:
            assert sorted(plain[table], key=key) == sorted(other[table], key=key)


def test_rows_of_all_scenes_that_would_become_too_many_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("stone_datasets.scene_tables.ALWAYS_BYTES", 0)
    folder = write_published(tmp_path / "dataset", SyntheticDataset(scenes=2, frames=1))
    write(folder, "category", [{"token": str(number), "name": "x" * 900} for number in range(900)])
    assert len(parted(folder, tmp_path / "few")) == 2
    monkeypatch.setattr("stone_datasets.scene_tables.MOST_GROWTH", 1)
    with refused_as("DST-048"):
        parted(folder, tmp_path / "many")


def test_little_is_held_before_it_is_written(good: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = parted(good, tmp_path / "plain")
    monkeypatch.setattr("stone_datasets.scene_tables.HELD_BYTES", 1)
    monkeypatch.setattr("stone_datasets.scene_tables.LINES_AT_ONCE", 2)
    assert parted(good, tmp_path / "piecemeal") == plain


def test_splits_are_those_that_name_the_scene(tmp_path: Path) -> None:
    write_splits(tmp_path, "meadow", ("train", "all"))
    assert (tmp_path / "splits.json").read_text() == '{\n "train": [\n  "meadow"\n ],\n "all": [\n  "meadow"\n ]\n}\n'
