"""Class maps are stated, and what they do not name is refused."""

from pathlib import Path

import numpy as np
import pytest

from stone_base.label_grid import PAPER
from stone_datasets.classes import class_map_of, read_class_map
from stone_datasets.labels import layout_of_labels, read_labels
from stone_datasets.reading import check_dataset
from stone_exports.files import ExportFileSpan
from stone_files.dataset_faults import DATASET_FAULTS
from stone_files.dataset_layouts import LAYOUTS
from stone_files.npz import npz_bytes
from testing.refusals import refused_as
from tests.stone_datasets.malformed import ANNOTATED, KINDS, Kind

GRID = np.zeros(PAPER.shape, np.uint8)


def labels(folder: Path, **arrays: np.ndarray) -> ExportFileSpan:  # type: ignore[type-arg]
    content = npz_bytes(arrays)
    (folder / "labels.npz").write_bytes(content)
    return ExportFileSpan(folder / "labels.npz", "labels.npz", 0, len(content))


def mapped(folder: Path, text: str) -> Path:
    (folder / "classes.yaml").write_text(text)
    return folder / "classes.yaml"


WRITTEN = {
    "yaml": "name: lidarseg\nclasses: {17: free, 11: T, 14: P, 16: N, 255: unobserved}\n",
    "json": '{"name": "lidarseg", "classes": {"17": "free", "11": "T", "14": "P", "16": "N", "255": "unobserved"}}',
}


@pytest.mark.parametrize("form", WRITTEN)
def test_numbers_become_the_classes_that_the_file_says(tmp_path: Path, form: str) -> None:
    said = read_class_map(mapped(tmp_path, WRITTEN[form]))
    assert said.name == "lidarseg"
    numbers = np.resize(np.array([17, 11, 14, 16, 255], np.uint8), PAPER.shape)
    found = read_labels(labels(tmp_path, semantics=numbers), said)
    assert np.array_equal(found.classes, np.resize(np.array([0, 1, 2, 3, 0], np.uint8), PAPER.shape))
    assert found.mask_lidar is not None
    assert np.array_equal(found.mask_lidar == 0, numbers == 255)
    assert found.mask_camera is None


def test_what_is_unobserved_takes_itself_out_of_the_mask(tmp_path: Path) -> None:
    numbers, mask = GRID.copy(), GRID.copy()
    numbers[0], mask[:2] = 255, 1
    found = read_labels(labels(tmp_path, semantics=numbers, mask_lidar=mask, mask_camera=mask))
    assert found.mask_lidar is not None
    assert found.mask_camera is not None
    assert found.mask_lidar[0].max() == 0
    assert found.mask_lidar[1].min() == 1
    assert np.array_equal(found.mask_camera, mask)
    assert found.classes.max() == 0


def test_unnamed_numbers_are_refused_and_arrays_that_nobody_asked_for_are_left(tmp_path: Path) -> None:
    said = read_class_map(mapped(tmp_path, "name: short\nclasses: {0: free, 1: T}\n"))
    with refused_as("DST-066", match="the labels have the values 2, 3, which 'short' does not define"):
        read_labels(labels(tmp_path, semantics=np.resize(np.arange(4, dtype=np.uint8), PAPER.shape)), said)
    found = read_labels(labels(tmp_path, distance_squared=GRID.astype(np.float16), semantics=GRID))
    assert (found.mask_lidar, found.mask_camera) == (None, None)


BAD = {
    "none": "", "no YAML": "{", "a list": "[1]", "no classes": "name: x",
    "a class of nobody": "name: x\nclasses: {0: grass}", "a class of a number": "name: x\nclasses: {0: 1}",
    "a number of nobody": "name: x\nclasses: {256: T}", "a negative one": "name: x\nclasses: {-1: T}",
    "a name for a number": "name: x\nclasses: {road: T}", "a truth for a number": "name: x\nclasses: {true: T}",
    "two of one number": "name: x\nclasses: {1: T, 1: P}", "a tag": "!!python/object:os.system {}",
    "far too long": "name: x\n" + "#" * 70_000,
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_a_file_of_classes_that_is_none_is_refused(tmp_path: Path, name: str) -> None:
    with refused_as("DST-070") as refused:
        read_class_map(mapped(tmp_path, BAD[name]))
    assert refused.value.code == "DST-070"


@pytest.mark.field_data
def test_real_labels_of_occ3d_are_recognised_and_read_by_the_classes_that_are_stated(field_data: Path) -> None:
    path = next((field_data / "occ3d_labels").rglob("labels.npz"))
    span = ExportFileSpan(path, "labels.npz", 0, path.stat().st_size)
    layout = layout_of_labels(span, has_dashes=False)
    assert layout == LAYOUTS["occ3d"]
    with refused_as("DST-063", match=r"shape \(200, 200, 16\); the grid is paper"):
        read_labels(span)
    with refused_as("DST-066"):
        read_labels(span, layout=layout)
    meanings = {number: "N" for number in range(17)} | {11: "T", 14: "P", 17: "free"}
    labels = read_labels(span, class_map_of("nuscenes", meanings), layout)
    with np.load(path) as given:
        assert np.array_equal(labels.classes == 0, given["semantics"] == 17)
        assert np.array_equal(labels.classes == 1, given["semantics"] == 11)
        assert labels.mask_lidar is not None
        assert np.array_equal(labels.mask_lidar, given["mask_lidar"])


def refused(folder: Path, kind: Kind) -> None:
    code, edit = kind
    edit(folder)
    check = check_dataset(folder)
    assert check.contents is None
    told = [str(fault) for fault in check.faults.found]
    assert {fault.code for fault in check.faults.found} == {code}, told


@pytest.mark.parametrize("name", KINDS)
def test_a_malformed_release_is_refused_by_its_code(copied: Path, name: str) -> None:
    refused(copied, KINDS[name])


@pytest.mark.parametrize("name", ANNOTATED)
def test_malformed_annotations_are_refused_by_their_code(copied_annotated: Path, name: str) -> None:
    refused(copied_annotated, ANNOTATED[name])


def test_every_code_of_datasets_is_one_fault_s_and_has_a_kind_that_provokes_it() -> None:
    elsewhere = {
        *("DST-006", "DST-007", "DST-008", "DST-009"),  # test_released.py
        *("DST-043", "DST-044", "DST-073", "DST-074"),  # test_released_wrong.py
        "DST-003",  # test_files.py
        "DST-005",  # test_files.py
        "DST-048",  # test_scene_tables.py
        "DST-049",  # what only an import refuses: tests/services/labeler/imports
        "DST-071",
        "DST-072",
        "DST-070",  # above
    }
    assert set(DATASET_FAULTS) == {code for code, _ in (*KINDS.values(), *ANNOTATED.values())} | elsewhere
    assert len(DATASET_FAULTS) > 45
    assert all(fault.meaning and fault.likely for fault in DATASET_FAULTS.values())
