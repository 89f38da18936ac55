"""What is refused of a dataset and of what its index left: spans, files, poses, labels."""

import json
from collections.abc import Callable
from pathlib import Path
from shutil import copytree
from typing import Any

import numpy as np
import pytest

from services.labeler.imports.answers import IndexedSceneAnswer
from services.labeler.imports.indexing import index_dataset, region_of
from services.labeler.imports.scene_parts import DatasetOpening, read_scene_parts, write_scene_parts
from stone_datasets.classes import OWN_CLASSES
from stone_datasets.faults import DatasetFaultError
from testing.refusals import refused_as
from testing.worlds.imported import tar_of, write_import, write_index, write_scene
from testing.worlds.published_datasets import (
    VERSION,
    SyntheticDataset,
    made_labels,
    write_published,
    write_published_tar,
)

GOOD = SyntheticDataset(labels=(made_labels(1), made_labels(2)))


@pytest.fixture(scope="module")
def indexed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Both scenes of the good dataset, indexed; nothing in it may be changed."""
    folder = tmp_path_factory.mktemp("indexed")
    write_index(write_published_tar(folder / "dataset.tar", GOOD), folder)
    return folder


Damage = Callable[[Path], object]


def _spans(change: Callable[[np.ndarray, np.ndarray], object]) -> Damage:
    """Other spans than were indexed."""

    def damage(out: Path) -> None:
        folder = out / "scenes" / "000000"
        parts = read_scene_parts(folder, out / "dataset.tar")
        change(parts.spans.places, parts.spans.labels)
        write_scene_parts(folder, parts.about, parts.sequence, parts.spans)

    return damage


DAMAGES: dict[str, Damage] = {
    "a span that leaves the tar": _spans(lambda places, _: places.__setitem__((0, 0), 1 << 50)),
    "a span of more than the tar has": _spans(lambda places, _: places.__setitem__((0, 1), 1 << 50)),
    "a span from before the tar": _spans(lambda _, labels: labels.__setitem__((0, 0), -5)),
    "no spans": lambda out: (out / "scenes/000000/files.npz").unlink(),
    "no sequence": lambda out: (out / "scenes/000000/sequence.npz").write_bytes(b"PK\5\6" + bytes(18)),
    "a tar that was cut off": lambda out: (out / "dataset.tar").write_bytes(b""),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_what_the_index_left_is_not_believed(indexed: Path, tmp_path: Path, name: str) -> None:
    out = copytree(indexed, tmp_path / "out")
    DAMAGES[name](out)
    with refused_as("scene_damaged"):
        write_scene(out / "dataset.tar", out, 0)


def refused(folder: Path, tmp_path: Path) -> DatasetFaultError:
    """Why the dataset in a folder is not imported."""
    with pytest.raises(DatasetFaultError) as caught:
        write_import(folder, tmp_path / "out")
    return caught.value


def _rows(folder: Path, table: str, change: Callable[[list[dict[str, Any]]], object]) -> None:
    path = folder / VERSION / f"{table}.json"
    rows = json.loads(path.read_text())
    change(rows)
    path.write_text(json.dumps(rows))


def test_faults_of_files_are_told_with_the_row_that_they_have_in_the_dataset(tmp_path: Path) -> None:
    folder = write_published(tmp_path / "dataset", GOOD)
    rows = json.loads((folder / VERSION / "sample_data.json").read_text())
    row = next(at for at in range(len(rows) - 1, 0, -1) if "LIDAR" in rows[at]["filename"])
    sweep = folder / rows[row]["filename"]
    sweep.unlink()
    sweep.write_bytes(b"1234567")
    fault = refused(folder, tmp_path)
    assert fault.code == "DST-051"
    assert f"sample_data.json row {row + 1}" in str(fault)


@pytest.mark.parametrize(("gone", "code"), [("samples", "DST-050"), ("gts", "DST-060")])
def test_a_file_that_is_not_there_is_refused_before_any_is_copied(tmp_path: Path, gone: str, code: str) -> None:
    folder = write_published(tmp_path / "dataset", GOOD)
    next(path for path in sorted((folder / gone).rglob("*"))[::-1] if path.is_file()).unlink()
    with pytest.raises(DatasetFaultError) as caught:
        write_index(tar_of(folder, tmp_path / "d.tar"), tmp_path / "out")
    assert caught.value.code == code


def test_labels_that_are_free_everywhere_are_refused(tmp_path: Path) -> None:
    what = SyntheticDataset(scenes=1, labels=[made_labels(1, highest=0)])
    fault = refused(write_published(tmp_path / "dataset", what), tmp_path)
    assert fault.code == "DST-071"


def test_poses_that_no_lattice_holds_are_refused(tmp_path: Path) -> None:
    folder = write_published(tmp_path / "dataset", GOOD)

    def shift(rows: list[dict[str, Any]]) -> None:
        for row in rows:
            row["translation"][1] += 5_400_000.0

    _rows(folder, "ego_pose", shift)
    fault = refused(folder, tmp_path)
    assert fault.code == "DST-049"


def test_a_folder_is_no_tar(tmp_path: Path) -> None:
    folder = write_published(tmp_path / "dataset", GOOD)
    opening = DatasetOpening(folder, "published", "0" * 64, OWN_CLASSES)
    with pytest.raises(DatasetFaultError):
        index_dataset(opening, tmp_path, lambda *_: None)


def test_scenes_without_labels_are_indexed_as_such(tmp_path: Path) -> None:
    what = SyntheticDataset(scenes=1)
    answer = write_index(write_published_tar(tmp_path / "d.tar", what), tmp_path / "out")
    assert [(scene.name, scene.frames, scene.is_labelled) for scene in answer.scenes] == [("field-0000", 3, False)]


@pytest.mark.parametrize(
    ("location", "region"),
    [
        ("boston-seaport", "boston-seaport"),
        (" lake ", "lake"),
        ("Lake  Geneva", "Lake-Geneva"),
        ("quarry/north", ""),
        ("unknown", ""),
        ("", ""),
        ("36.3724,127.3628", ""),
        ("-1.5, +20", ""),
        ("a\u202eb", ""),
        ("x" * 65, ""),
    ],
)
def test_the_region_of_a_scene_is_what_its_log_names(location: str, region: str) -> None:
    assert region_of(location) == region


@pytest.mark.parametrize("region", ["a\u202eb", "../up", "a b", "x" * 65])
def test_a_region_that_is_no_plain_name_is_believed_of_no_child(region: str) -> None:
    with pytest.raises(ValueError, match="string_pattern_mismatch"):
        IndexedSceneAnswer(ordinal=0, name="a", frames=1, is_labelled=True, region=region)
