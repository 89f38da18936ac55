"""The released dataset is imported from its ZIP where it lies, at its own grid, and exported again as published."""

import json
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest

from services.domain.sequences.label_sources import SOURCE, SOURCE_INDEX
from services.labeler.exports.dataset_source import DatasetSource
from services.labeler.exports.source import REPORT
from services.labeler.imports.fused_labels import FusedLabels, VoteBricks
from stone.geometry.lattice import indices_of
from stone.geometry.se3 import SE3
from stone_base.label_grid import RELEASE
from stone_exports.files import FolderFiles
from stone_exports.frames import frames_in
from testing.refusals import refused_as
from testing.worlds.imported import artefacts_of, write_import, write_index
from testing.worlds.released_datasets import (
    ReleasedDataset,
    released_files,
    with_quaternions_last,
    write_released_zip,
)

TWIN = ReleasedDataset(scenes=2, frames=3)


@pytest.fixture(scope="module")
def imported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("imported")
    write_import(write_released_zip(folder / "STONE.zip", TWIN), folder)
    return folder


def source_of(folder: Path, scene: int, out: Path) -> Path:
    """The files of a scene as its export writes them."""
    artefacts = artefacts_of(folder, scene)
    packs = tuple(sorted((artefacts / SOURCE).glob("*.pack")))
    DatasetSource(artefacts / SOURCE_INDEX, packs).opened().write(out)
    return out


def test_every_label_sensor_file_and_row_comes_back_byte_for_byte(imported: Path, tmp_path: Path) -> None:
    found, rows = dict[str, bytes](), dict[str, set[bytes]]()
    for scene in range(TWIN.scenes):
        out = source_of(imported, scene, tmp_path / str(scene))
        for path in (one for one in out.rglob("*") if one.is_file()):
            name, content = path.relative_to(out).as_posix(), path.read_bytes()
            found[name] = content
            rows.setdefault(name, set()).update(content.split(b"\n"))
    for name, content in released_files(TWIN):
        if name.endswith(".pkl"):
            continue
        if name.endswith(".json"):
            assert {line.rstrip(b",") for line in rows[name]} == {line.rstrip(b",") for line in content.split(b"\n")}
        else:
            assert found[name] == content, name


def test_labels_have_the_tokens_of_the_platform_and_unknown_voxels_become_the_mask(imported: Path) -> None:
    for scene in range(TWIN.scenes):
        report = json.loads((artefacts_of(imported, scene) / REPORT).read_text())
        assert (report["grid"], report["layout"], report["rewritten_frames"]) == (RELEASE.as_record(), "release", 3)
    given = {name: np.load(BytesIO(one))["label"] for name, one in released_files(TWIN) if name.endswith(".npz")}
    tokens, pack = TWIN.tables.tokens(1), (artefacts_of(imported, 1) / "labels" / "000000.pack").read_bytes()
    begins = [
        at for at in range(len(pack)) if pack.startswith(b"PK\3\4", at) and b"semantics.npy" in pack[at : at + 60]
    ]
    assert len(begins) == len(tokens)
    for token, begin, end in zip(tokens, begins, [*begins[1:], len(pack)], strict=True):
        label = given[f"gts/{TWIN.tables.names[1]}/{TWIN.written(token)}/labels.npz"]
        arrays = np.load(BytesIO(pack[begin:end]))
        assert np.array_equal(arrays["semantics"], np.where(label == 255, 0, label))
        assert np.array_equal(arrays["mask_lidar"] == 0, label == 255)


def test_models_find_frames_of_both_forms_of_tokens(imported: Path, tmp_path: Path) -> None:
    frames = frames_in(FolderFiles(source_of(imported, 0, tmp_path)))
    assert tuple(frame.token for frame in frames) == TWIN.tables.tokens(0)
    assert all(frame.labels is not None for frame in frames)


def test_a_dataset_whose_sweeps_refute_its_labels_is_not_imported(tmp_path: Path) -> None:
    turned = replace(TWIN, changed=with_quaternions_last)
    with refused_as("DST-073", match="LiDAR mount read x y z w"):
        write_index(write_released_zip(tmp_path / "turned.zip", turned), tmp_path / "out")


def test_a_voxel_of_0_4_m_votes_for_the_eight_map_voxels_that_it_covers(tmp_path: Path) -> None:
    grid = np.zeros(RELEASE.shape, np.uint8)
    places = np.array([[0, 0, 0], [100, 101, 3], [199, 199, 15]])
    grid[tuple(places.T)] = [1, 2, 3]
    labels = FusedLabels("meadow", tmp_path / "votes", VoteBricks(256, RELEASE))
    labels.add(grid, SE3.from_parts(np.array([1.0, 0, 0, 0]), np.array([0.2, -0.4, 0.6])))
    found = {
        tuple(index): kind
        for _, keys, kinds in labels.tiles()
        for index, kind in zip(indices_of(keys).tolist(), kinds.tolist(), strict=True)
    }
    cubes = np.stack(np.meshgrid(*[[0, 1]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    low = np.array([-199, -202, -2])  # [-200, -200, -5] + [1, -2, 3], map voxels of 0.2 m
    wanted = {
        tuple(index): kind
        for place, kind in zip(places, (1, 2, 3), strict=True)
        for index in (low + 2 * place + cubes).tolist()
    }
    assert found == wanted
