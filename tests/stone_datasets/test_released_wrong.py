"""A released dataset with one thing wrong is refused by one code, in one sentence that quotes the wrong value.

Each variant is the twin with one thing changed: a value of its maker, a table, or the bytes of a file.
"""

import json
import re
import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np
import pytest

from stone_base.label_grid import PAPER, RELEASE, LabelGrid
from stone_datasets.reading import check_dataset
from stone_datasets.stated_layout import UNSTATED, StatedLayout
from stone_files.npz import npz_bytes
from testing.worlds.published_datasets import VERSION, Row
from testing.worlds.released_datasets import ReleasedDataset, of_tables, released_files, with_quaternions_last

TWIN = ReleasedDataset(frames=8)
TABLES = TWIN.tables
Files = dict[str, bytes]
Written = Iterable[tuple[str, bytes]]
Grid = np.ndarray[Any, Any]


@dataclass(frozen=True)
class Wrong:
    """A code, a pattern of its sentence; what is written, how its files are changed, and what is stated of it."""

    code: str
    said: str
    what: ReleasedDataset = TWIN
    change: Callable[[Files], Written] = lambda files: files.items()
    stated: StatedLayout = UNSTATED


def label(scene: int, frame: int) -> str:
    return f"gts/{TABLES.names[scene]}/{TWIN.written(TABLES.tokens(scene)[frame])}/labels.npz"


def sweep(scene: int, frame: int) -> str:
    return TABLES.filename("LIDAR_TOP", TABLES.stamp_us(scene, frame))


LABEL = label(0, 3)


def relabelled(change: Callable[[Grid], Grid], key: str = "label") -> Callable[[Files], Written]:
    """Other classes in the labels of one frame."""

    def changed(files: Files) -> Written:
        with np.load(BytesIO(files[LABEL])) as given:
            return (files | {LABEL: npz_bytes({key: change(given["label"])})}).items()

    return changed


def fortran(files: Files) -> Written:
    """The labels of one frame in the order of Fortran, as numpy writes a transposed array."""
    with np.load(BytesIO(files[LABEL])) as given:
        file = BytesIO()
        np.savez_compressed(file, label=np.asfortranarray(given["label"]))
    return (files | {LABEL: file.getvalue()}).items()


def taken(pairs: Mapping[str, str]) -> Callable[[Files], Written]:
    """Files with the content of others."""
    return lambda files: (files | {name: files[other] for name, other in pairs.items()}).items()


def of_frame_before(name: Callable[[int, int], str]) -> Callable[[Files], Written]:
    return taken({name(scene, frame): name(scene, frame - 1) for scene in (0, 1) for frame in range(1, 8)})


def exchanged(name: Callable[[int, int], str]) -> Callable[[Files], Written]:
    return taken({name(scene, frame): name(1 - scene, frame) for scene in (0, 1) for frame in range(8)})


def late_poses(files: Files) -> Written:
    """Every pose is that of the frame before; stamps and tokens stay."""
    name, step = f"{VERSION}/ego_pose.json", len(TABLES.sensors)
    rows: list[Row] = json.loads(files[name])
    pose_of = [{key: row[key] for key in ("rotation", "translation")} for row in rows]
    moved = [row | pose_of[at - step if at // step % 8 else at] for at, row in enumerate(rows)]
    return (files | {name: json.dumps(moved).encode()}).items()


def without(*names: str) -> Callable[[Files], Written]:
    return lambda files: ((name, content) for name, content in files.items() if name not in names)


def with_splits(**splits: list[str]) -> Callable[[Files], Written]:
    return lambda files: (files | {"splits.json": json.dumps(splits).encode()}).items()


def in_grid(**facts: Any) -> LabelGrid:
    return replace(RELEASE, name="other", **facts)


def in_turn(table: str, row: Row) -> Row:
    return {key: value.replace("-", "") if key == "token" and row["prev"] else value for key, value in row.items()}


HALF_X, HALF_Z = (-39.8, -40.0, -1.0), (-40.0, -40.0, -0.8)
SHARE = r"\d\d?\.\d\d% of \d+ returns .*"
WRONG = {
    "half a voxel off in x": Wrong(
        "DST-073", rf"{SHARE} half a voxel to .x: (9\d|100)", replace(TWIN, labels_in=in_grid(min_m=HALF_X))
    ),
    "half a voxel off in z": Wrong(
        "DST-073", rf"{SHARE} half a voxel to .z: (9\d|100)", replace(TWIN, labels_in=in_grid(min_m=HALF_Z))
    ),
    "0.2 m stated for 0.4": Wrong(
        "DST-073",
        rf"{SHARE} voxels of 0\.4 m from z = -1 m: (9\d|100)",
        stated=StatedLayout(grid=in_grid(min_m=(-20.0, -20.0, -1.0), voxel_m=0.2)),
    ),
    "another shape stated": Wrong(
        "DST-063", r"has shape \(200, 200, 16\); the grid is paper", stated=StatedLayout(grid=PAPER)
    ),
    "mounts x y z w": Wrong(
        "DST-073",
        rf"{SHARE} LiDAR mount read x y z w: (9\d|100)",
        replace(TWIN, changed=of_tables(lambda row: with_quaternions_last("", row), "calibrated_sensor")),
    ),
    "poses x y z w": Wrong(
        "DST-073",
        rf"{SHARE} poses read x y z w: (9\d|100)",
        replace(TWIN, changed=of_tables(lambda row: with_quaternions_last("", row), "ego_pose")),
    ),
    "mounts and poses x y z w": Wrong(
        "DST-073",
        rf"{SHARE} LiDAR mount read x y z w: (9\d|100)",
        replace(TWIN, changed=with_quaternions_last),
    ),
    "poses of the frame before": Wrong("DST-073", rf"{SHARE} poses of the frame after: (9\d|100)", change=late_poses),
    "labels of the frame before": Wrong("DST-074", r"\d+ returns of its sweep .* gts/", change=of_frame_before(label)),
    "sweeps of the frame before": Wrong("DST-074", r"\d+ returns of its sweep .* gts/", change=of_frame_before(sweep)),
    "labels of another scene": Wrong(
        "DST-074", rf"\d+ returns of its sweep .* gts/{TABLES.names[1]}/", change=exchanged(label)
    ),
    "sweeps of another scene": Wrong(
        "DST-074", rf"\d+ returns of its sweep .* gts/{TABLES.names[1]}/", change=exchanged(sweep)
    ),
    "a torn drive": Wrong(
        "DST-044",
        "the 2 scenes of the drive that starts with 'field-0000' are 1 in 'train' and 1 in 'test'",
        change=with_splits(train=["field-0000"], test=["field-0001"]),
    ),
    "class 17": Wrong(
        "DST-066", r"the labels have the values 17, which 'stone' does", change=relabelled(lambda grid: _set(grid, 17))
    ),
    "class 4": Wrong("DST-066", r"the labels have the values 4, which", change=relabelled(lambda grid: _set(grid, 4))),
    "floats": Wrong(
        "DST-064", r"label\.npy is float32 in C order", change=relabelled(lambda grid: grid.astype(np.float32))
    ),
    "64 bits": Wrong("DST-064", r"label\.npy is int64 in C order", change=relabelled(lambda grid: grid.astype(int))),
    "Fortran order": Wrong("DST-064", r"label\.npy is uint8 in Fortran order", change=fortran),
    "x and z exchanged": Wrong(
        "DST-063",
        r"has shape \(16, 200, 200\); the grid is release",
        change=relabelled(lambda grid: np.ascontiguousarray(grid.T)),
    ),
    "flat": Wrong("DST-063", r"has shape \(640000,\); the grid is release", change=relabelled(np.ravel)),
    "another key": Wrong(
        "DST-062", "it has no label, only semantics", change=relabelled(lambda grid: grid, key="semantics")
    ),
    "a frame without labels": Wrong("DST-060", rf"{LABEL}: it is missing", change=without(LABEL)),
    "a frame without its sweep": Wrong("DST-050", re.escape(sweep(0, 3)), change=without(sweep(0, 3))),
    "dashes in half of the tokens": Wrong(
        "DST-043",
        r"2 of 16 frame tokens have dashes; [0-9a-f]{32} differs from [0-9a-f-]{36}",
        replace(TWIN, changed=lambda table, row: in_turn(table, row) if table == "sample" else row),
    ),
    "a file twice": Wrong(
        "DST-006",
        rf"two files have the name '{TWIN.root}{LABEL}'",
        change=lambda files: [*files.items(), (LABEL, files[label(1, 0)])],
    ),
}


def _set(grid: Grid, value: int) -> Grid:
    return np.where(grid == 3, value, grid).astype(np.uint8)


@pytest.fixture(scope="module")
def twin() -> Files:
    return dict(released_files(TWIN))


def zipped(path: Path, files: Written) -> Path:
    with ZipFile(path, "w") as archive, warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of a name that is written twice
        for name, content in files:
            archive.writestr(f"{TWIN.root}{name}", content)
    return path


def test_the_twin_without_a_wrong_is_accepted(tmp_path: Path, twin: Files) -> None:
    assert check_dataset(zipped(tmp_path / "right.zip", twin.items())).contents is not None


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_dataset_is_refused_by_its_code_in_a_sentence_that_quotes_the_value(
    tmp_path: Path, twin: Files, name: str
) -> None:
    wrong = WRONG[name]
    files = twin if wrong.what is TWIN else dict(released_files(wrong.what))
    check = check_dataset(zipped(tmp_path / "wrong.zip", wrong.change(files)), stated=wrong.stated)
    assert check.contents is None
    assert {fault.code for fault in check.faults.found} == {wrong.code}
    sentence = str(check.faults.found[0])
    assert re.search(wrong.said, sentence), sentence
    assert "\n" not in sentence
    assert len(sentence) < 600
