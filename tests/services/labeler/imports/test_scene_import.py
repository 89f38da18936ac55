"""A scene of a published dataset imported by what a sandboxed child does, without a platform."""

import json
import tracemalloc
from io import BytesIO
from pathlib import Path
from shutil import copytree
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from services.labeler.child_answers import PublicationAnswer
from services.labeler.exports.meshes import open_mesh
from services.runtime.store.pack_reading import file_pieces, local_reader
from services.runtime.store.packs import read_index
from stone.sensors.sequence import Sequence
from stone_base.label_grid import PAPER
from stone_datasets.classes import class_map_of
from stone_datasets.labels import read_labels
from stone_exports.files import ExportFileSpan
from stone_files.npz import npz_bytes
from stone_recordings.sync.sequence_file import read_sequence
from testing.worlds.imported import artefacts_of, tar_of, write_import, write_index, write_scene, write_synthetic_import
from testing.worlds.published_datasets import (
    VERSION,
    SyntheticDataset,
    made_labels,
    write_annotated,
    write_published,
    write_published_tar,
)

LABELS = (made_labels(1), made_labels(2))
GOOD = SyntheticDataset(labels=LABELS, splits={"train": ["field-0000"], "val": ["field-0001"]})
ARTEFACTS = {
    "bev.png", "frames.parquet", "labels/000000.pack", "map.png", "mesh.ply", "report.json", "scene/scene.json",
    "sequence.npz", "source/000000.pack", "source/index.npz", "thumbnail.png",
}  # fmt: skip


@pytest.fixture(scope="module")
def imported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Both scenes of the good dataset; nothing in it may be changed."""
    folder = tmp_path_factory.mktemp("imported")
    write_synthetic_import(GOOD, folder)
    return folder


def source_of(out: Path) -> dict[str, bytes]:
    """The files of the source by name."""
    files = read_index((out / "source" / "index.npz").read_bytes())
    read = local_reader(out / "source")
    sizes = files.sizes_bytes.tolist()
    return {name: b"".join(file_pieces(files, at, (0, sizes[at]), read)) for at, name in enumerate(files.names)}


def labels_of(out: Path, told: PublicationAnswer) -> list[bytes]:
    (pack,) = told.packs
    content = (out / "labels" / Path(pack.name).name).read_bytes()
    return [content[offset : offset + length] for offset, length, _ in pack.ranges]


def sequence_in(out: Path) -> Sequence:
    return read_sequence((out / "sequence.npz").read_bytes())


def report_in(out: Path) -> dict[str, Any]:
    record: dict[str, Any] = json.loads((out / "report.json").read_text())
    return record


def test_a_scene_leaves_what_every_label_set_has_and_its_source(imported: Path) -> None:
    for ordinal in range(2):
        out = artefacts_of(imported, ordinal)
        names = {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()}
        assert names >= ARTEFACTS
        tiles = json.loads((out / "scene/scene.json").read_text())["tiles"]
        drawn = {f"scene/{kind}_{tile['name']}.bin" for tile in tiles for kind in ("tile", "mesh")}
        assert names == ARTEFACTS | drawn
        assert not (out.parent / "scratch").exists()


def test_the_source_has_the_bytes_of_the_dataset_and_no_labels(imported: Path, tmp_path: Path) -> None:
    folder = write_published(tmp_path / "dataset", GOOD)
    for ordinal, scene in enumerate(GOOD.names):
        source = source_of(artefacts_of(imported, ordinal))
        samples = {name: content for name, content in source.items() if name.startswith("samples/")}
        assert len(samples) == GOOD.frames * len(GOOD.sensors)
        assert all((folder / name).read_bytes() == content for name, content in samples.items())
        tables = {name for name in source if name.startswith(f"{VERSION}/")}
        assert len(tables) == 14
        assert set(source) == set(samples) | tables
        assert [row["name"] for row in json.loads(source[f"{VERSION}/scene.json"])] == [scene]
        assert list(source) == sorted(source)


def test_labels_tokens_stamps_and_poses_are_the_datasets(tmp_path: Path) -> None:
    (first, second) = write_synthetic_import(GOOD, tmp_path)
    for ordinal, told in enumerate((first, second)):
        sequence = sequence_in(artefacts_of(tmp_path, ordinal))
        assert tuple(told.tokens) == sequence.frames.tokens == GOOD.tokens(ordinal)
        stamps_us = [GOOD.stamp_us(ordinal, frame) for frame in range(GOOD.frames)]
        assert told.stamps_ns == sequence.frames.stamps_ns.tolist() == [stamp_us * 1000 for stamp_us in stamps_us]
        rows = json.loads(source_of(artefacts_of(tmp_path, ordinal))[f"{VERSION}/ego_pose.json"])
        said = {row["timestamp"]: row["rotation"] + row["translation"] for row in rows}
        assert sequence.frames.map_from_ego.wxyz_xyz.tolist() == [said[stamp_us] for stamp_us in stamps_us]
        assert labels_of(artefacts_of(tmp_path, ordinal), told) == [LABELS[0], LABELS[1], LABELS[0]]


def test_a_sequence_says_of_every_sensor_which_datum_a_frame_has_and_where_the_robot_was(imported: Path) -> None:
    sequence = sequence_in(artefacts_of(imported))
    assert sequence.pose_source == "dataset"
    assert list(sequence.inputs) == ["published"]
    assert {mount.name for mount in sequence.calibration.mounts} == {"CAM_FRONT", "CAM_BACK", "RADAR_FRONT"}
    assert sequence.frames.sweeps is not None
    for taken in sequence.frames.associations.values():
        assert taken.message_index.tolist() == [0, 1, 2]
        assert taken.dt_ns.tolist() == [20_000_000] * 3
    rows = json.loads(source_of(artefacts_of(imported))[f"{VERSION}/ego_pose.json"])
    said = {row["timestamp"] * 1000: row["rotation"] + row["translation"] for row in rows}
    assert sequence.track is not None
    assert (
        dict(zip(sequence.track.stamps_ns.tolist(), sequence.track.map_from_ego.wxyz_xyz.tolist(), strict=True)) == said
    )


def test_the_report_says_what_was_imported_and_what_it_has_not(imported: Path) -> None:
    out = artefacts_of(imported)
    report = report_in(out)
    assert report["parameters"]["profile"] == "imported"
    assert report["parameters"]["classes"]["classes"]["1"] == "T"
    assert report["reference"] is None
    assert report["rewritten_frames"] == 0
    assert report["findings"] == []
    assert report["frames"] == 3
    grids = [np.load(BytesIO(content))["semantics"] for content in (LABELS[0], LABELS[1], LABELS[0])]
    counts = np.sum([np.bincount(grid.reshape(-1), minlength=4) for grid in grids], axis=0)
    assert list(report["class_share_of_occupied"].values()) == pytest.approx(counts[1:] / counts[1:].sum(), abs=1e-6)
    table = pq.read_table(out / "frames.parquet")
    assert table["frame_token"].to_pylist() == list(GOOD.tokens(0))
    assert np.sum([table[name].to_numpy() for name in ("free_voxels", "t_voxels", "p_voxels", "n_voxels")]) == (
        3 * np.prod(PAPER.shape)
    )


def test_the_map_has_a_mesh_that_exports_open_and_a_scene_without_reference(imported: Path) -> None:
    out = artefacts_of(imported)
    report, scene = report_in(out), json.loads((out / "scene/scene.json").read_text())
    mesh = open_mesh(out / "mesh.ply")
    assert len(mesh.vertices) == report["map"]["vertices"]
    assert len(mesh.faces) == report["map"]["triangles"]
    assert set(np.unique(mesh.classes(slice(None)))) == {1, 2, 3}
    assert mesh.faces["indices"].max() < len(mesh.vertices)
    assert scene["reference"] is None
    assert scene["profile"] == "imported"
    assert sum(tile["voxels"] for tile in scene["tiles"]) == report["map"]["voxels"]


def test_an_import_again_gives_the_same_bytes(imported: Path, tmp_path: Path) -> None:
    again = copytree(imported, tmp_path / "again")
    before = {path: path.read_bytes() for path in artefacts_of(again).rglob("*") if path.is_file()}
    write_scene(again / "dataset.tar", again, 0)
    assert {path: path.read_bytes() for path in artefacts_of(again).rglob("*") if path.is_file()} == before


def test_labels_of_other_classes_are_written_as_ours(tmp_path: Path) -> None:
    raw, seen = np.full(PAPER.shape, 17, np.uint8), np.ones(PAPER.shape, np.uint8)
    raw[:, :, 9], raw[:9, :, 10], raw[0, 0, 0] = 11, 13, 255
    classes = class_map_of("occ3d", {17: "free", 11: "T", 13: "N", 255: "unobserved"})
    labels = [npz_bytes({"semantics": raw, "mask_lidar": seen, "mask_camera": seen})]
    what = SyntheticDataset(scenes=1, frames=2, labels=labels)
    (told,) = write_import(write_published_tar(tmp_path / "d.tar", what), tmp_path / "out", classes)
    out = artefacts_of(tmp_path / "out")
    (tmp_path / "labels.npz").write_bytes(labels_of(out, told)[1])
    with np.load(tmp_path / "labels.npz") as arrays:
        assert np.array_equal(arrays["semantics"], np.select([raw == 11, raw == 13], [1, 3], 0))
        assert np.array_equal(arrays["mask_lidar"], raw != 255)
        assert np.array_equal(arrays["mask_camera"], seen)
    assert told.totals.t_voxels == 2 * int((raw == 11).sum())
    assert told.totals.n_voxels == 2 * int((raw == 13).sum())
    assert report_in(out)["parameters"]["classes"] == {
        "name": "occ3d",
        "classes": {"11": "T", "13": "N", "17": "free", "255": "unobserved"},
    }
    assert report_in(out)["rewritten_frames"] == 2


FURTHER: dict[str, tuple[dict[str, np.ndarray], bool]] = {
    "confidence": ({"distance_squared": np.full(PAPER.shape, 1.5, np.float16)}, True),
    "both arrays": (
        {"distance_squared": np.ones(PAPER.shape, np.float16), "confidence": np.ones(PAPER.shape, np.uint8)},
        True,
    ),
    "a probability as float16": ({"confidence": np.ones(PAPER.shape, np.float16)}, False),
    "confidence of another kind": ({"distance_squared": np.zeros(PAPER.shape)}, False),
    "confidence of another shape": ({"distance_squared": np.zeros(PAPER.shape[:2], np.float16)}, False),
    "something else": ({"distance": np.zeros(PAPER.shape, np.float16)}, False),
    "text": ({"note": np.array(["x" * 999])}, False),
}


@pytest.mark.parametrize("name", FURTHER)
def test_labels_with_more_than_ours_have_are_written_anew(tmp_path: Path, name: str) -> None:
    further, is_kept = FURTHER[name]
    raw, seen = np.zeros(PAPER.shape, np.uint8), np.ones(PAPER.shape, np.uint8)
    raw[::3, :, 9] = 2
    grids = {"semantics": raw, "mask_lidar": seen, "mask_camera": seen}
    content = npz_bytes(grids | further)
    (tmp_path / "labels.npz").write_bytes(content)
    span = ExportFileSpan(tmp_path / "labels.npz", "labels.npz", 0, len(content))
    assert (read_labels(span).content == content) is is_kept
    assert np.array_equal(read_labels(span).classes, raw)


def test_masks_that_a_dataset_has_not_are_said_to_be_missing(tmp_path: Path) -> None:
    raw = np.zeros(PAPER.shape, np.uint8)
    raw[:, :, 9] = 2
    what = SyntheticDataset(scenes=1, frames=2, labels=[npz_bytes({"semantics": raw})])
    (told,) = write_synthetic_import(what, tmp_path)
    report = report_in(artefacts_of(tmp_path))
    assert [finding["code"] for finding in report["findings"]] == ["IMP-601", "IMP-602"]
    assert report["observed_ratio"] == {"lidar": None, "camera": None}
    (tmp_path / "labels.npz").write_bytes(labels_of(artefacts_of(tmp_path), told)[0])
    with np.load(tmp_path / "labels.npz") as arrays:
        assert np.array_equal(arrays["semantics"], raw)
        assert arrays["mask_lidar"].all()
        assert arrays["mask_camera"].all()


def test_occ3ds_layout_gets_tables_and_names_of_the_release(tmp_path: Path) -> None:
    tar = tar_of(write_annotated(tmp_path / "annotated", GOOD), tmp_path / "d.tar")
    told = write_import(tar, tmp_path / "out")
    for ordinal in range(2):
        out = artefacts_of(tmp_path / "out", ordinal)
        source, sequence = source_of(out), sequence_in(out)
        data = json.loads(source[f"{VERSION}/sample_data.json"])
        assert {row["filename"] for row in data} == {name for name in source if name.startswith("samples/")}
        assert [row["token"] for row in json.loads(source[f"{VERSION}/sample.json"])] == told[ordinal].tokens
        assert told[ordinal].tokens == list(GOOD.tokens(ordinal))
        assert json.loads(source[f"{VERSION}/splits.json"]) == {("train", "val")[ordinal]: [GOOD.names[ordinal]]}
        assert sequence.frames.sweeps is None
        assert set(sequence.frames.associations) == {"CAM_FRONT", "CAM_BACK"}
        assert labels_of(out, told[ordinal]) == [LABELS[0], LABELS[1], LABELS[0]]


def peak_bytes(what: SyntheticDataset, folder: Path) -> int:
    tar = write_published_tar(folder.with_suffix(".tar"), what)
    write_index(tar, folder)
    tracemalloc.start()
    try:
        write_scene(tar, folder, 0)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.whole
def test_memory_does_not_grow_with_frames(tmp_path: Path) -> None:
    """Catches alone labels, files or votes of a scene that are held together."""
    few, many = (SyntheticDataset(1, frames, labels=LABELS, turns_after=4) for frames in (9, 36))
    peak_bytes(few, tmp_path / "warm")
    short, long = peak_bytes(few, tmp_path / "few"), peak_bytes(many, tmp_path / "many")
    assert long < short + 27 * 20_000  # of a frame its rows, hashes and spans; its grids are 6 MiB
