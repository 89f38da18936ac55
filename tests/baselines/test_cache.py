"""Rows and frames as they are read: what has changed is read anew, what says something impossible is refused."""

import json
import os
import tarfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from shutil import copytree
from typing import Any

import numpy as np
import pytest

from baselines import cache
from baselines.cache import CachedFrame, CachedStore, cached_frames, data_hash, write_record
from baselines.data import FrameDataset, FrameRequest
from baselines.frame_record import FrameRecord, WantedLabels, read_record
from baselines.inputs import InputConfig
from baselines.lattice import VoxelLattice
from baselines.row_config import known_rows, read_row, row_of
from baselines.run_folder import differences, read_run_row, write_run_row
from baselines.sources import labelled_frames
from stone.geometry.se3 import SE3
from stone_exports.files import DamagedExportError
from stone_files.npz import npz_bytes
from testing.refusals import refused_as
from testing.worlds.small_export import CAMERAS, SmallExport, write_small_export
from tests.baselines.small_training import row_record, small_row

INPUTS = InputConfig("C+L+R", image_size_px=(24, 32), with_depth=True)
RIG = SmallExport("field", 3, CAMERAS, ("RADAR_FRONT",))


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three frames of all sensors; nothing in it may be changed."""
    return write_small_export(tmp_path_factory.mktemp("rig"), RIG)


@pytest.fixture
def copied(rig: Path, tmp_path: Path) -> Path:
    copytree(rig, tmp_path / "copied")
    return tmp_path / "copied"


@pytest.fixture
def read(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Tokens of frames that were read from exports, as they are."""
    tokens: list[str] = []

    def heard(frame: object, *rest: object) -> FrameRecord:
        tokens.append(frame.token)  # type: ignore[attr-defined]
        return read_record(frame, *rest)  # type: ignore[arg-type]

    monkeypatch.setattr(cache, "read_record", heard)
    return tokens


def cached(
    exports: Path | Sequence[Path], folder: Path, inputs: InputConfig = INPUTS, least_confidence: float = 0.0
) -> tuple[CachedFrame, ...]:
    paths = (exports,) if isinstance(exports, Path) else tuple(exports)
    return cached_frames(labelled_frames(paths, WantedLabels(least_confidence)), inputs, folder, lambda *_: None)


def test_a_record_is_read_as_it_was_written(rig: Path, tmp_path: Path) -> None:
    source = labelled_frames((rig,))[1]
    record = read_record(source.frame, source.labels, INPUTS)
    found = cached(rig, tmp_path)[1].read()
    assert (found.token, found.sequence, found.stamp_us) == (record.token, record.sequence, record.stamp_us)
    assert np.abs(found.returns[:, :3] - record.returns[:, :3]).max() <= 0.002 + 1e-5
    assert np.array_equal(found.returns[:, 3], np.rint(record.returns[:, 3]))
    assert np.array_equal(found.detections, record.detections)
    np.testing.assert_array_equal(found.global_from_ego.wxyz_xyz, record.global_from_ego.wxyz_xyz)
    assert np.array_equal(found.labels, record.labels)
    assert len(found.pictures) == len(CAMERAS)
    for one, other in zip(found.pictures, record.pictures, strict=True):
        assert one.jpeg == other.jpeg
        assert np.array_equal(one.intrinsics, other.intrinsics)
        assert np.array_equal(one.ego_from_camera, other.ego_from_camera)


@pytest.mark.parametrize("reach_m", [0.0, 0.0019, -130.99, 130.99])
def test_returns_are_kept_to_two_millimetres_wherever_they_are(reach_m: float, tmp_path: Path) -> None:
    returns = np.array([[reach_m, -reach_m, reach_m / 3, 199.6]], np.float32)
    pose = SE3.identity()
    write_record(tmp_path / "a", FrameRecord("a", "b", 0, pose, returns, np.zeros((0, 6), np.float32), (), None))
    found = CachedFrame(tmp_path / "a", "a", "b", 0, (0, 0, 0, 0), "").read().returns
    assert np.abs(found[:, :3] - returns[:, :3]).max() <= 0.002 + 1e-5
    assert found[0, 3] == 200


def test_voxels_of_each_class_are_said(rig: Path, tmp_path: Path) -> None:
    for frame in cached(rig, tmp_path):
        labels = frame.read().labels
        assert frame.voxels == tuple((labels == name).sum() for name in range(4))
        assert min(frame.voxels) > 0


def test_what_has_not_changed_is_not_read_again(rig: Path, tmp_path: Path, read: list[str]) -> None:
    first = cached(rig, tmp_path)
    assert sorted(read) == sorted(RIG.tokens)
    read.clear()
    assert cached(rig, tmp_path) == first
    assert read == []


@pytest.mark.parametrize("counted", ["all", "observed"])
def test_occupied_voxels_of_low_confidence_are_not_trained_on(counted: Any, copied: Path, tmp_path: Path) -> None:
    lattice = VoxelLattice((-6.4, -6.4, -2.0), shape=(64, 64, 32))
    request = FrameRequest(InputConfig("L"), lattice, counted=counted)
    paths = [copied / "gts" / "field" / token / "labels.npz" for token in RIG.tokens]
    with refused_as("no_confidence", match=r"labels\.npz.*stone label --confidence"):
        cached(copied, tmp_path / "cache", least_confidence=0.7)
    usual = FrameDataset(CachedStore(cached(copied, tmp_path / "cache")), request)[0, 1].labels.numpy()[0]
    for number, path in enumerate(paths):
        arrays = dict(np.load(path))
        sure = np.random.default_rng(number).integers(1, 256, arrays["semantics"].shape)
        arrays["confidence"] = np.where(arrays["semantics"] == 0, 0, sure).astype(np.uint8)
        path.write_bytes(npz_bytes(arrays))
    frames = cached(copied, tmp_path / "cache", least_confidence=0.7)
    arrays = np.load(paths[1])
    is_unsure = (arrays["semantics"] > 0) & (arrays["confidence"] / 255 < 0.7)
    assert frames[1].unsure == is_unsure.sum() > 0
    assert frames[1].voxels[1:] == tuple((arrays["semantics"][~is_unsure] == kind).sum() for kind in (1, 2, 3))
    found = FrameDataset(CachedStore(frames), request)[0, 1].labels.numpy()[0]
    assert np.array_equal(found, np.where(is_unsure[96:160, 96:160], 255, usual))
    assert not np.array_equal(found, usual)
    again = FrameDataset(CachedStore(cached(copied, tmp_path / "cache")), request)[0, 1].labels.numpy()[0]
    assert np.array_equal(again, usual)


def change_labels(folder: Path, token: str) -> None:
    path = folder / "gts" / "field" / token / "labels.npz"
    os.utime(path, ns=(0, path.stat().st_mtime_ns + 1))


def change_sweep(folder: Path, token: str) -> None:
    sweep = sorted((folder / "samples" / "LIDAR_TOP").iterdir())[RIG.tokens.index(token)]
    sweep.write_bytes(sweep.read_bytes()[:-20])


def change_pose(folder: Path, token: str) -> None:
    table = folder / "v1.0-trainval" / "ego_pose.json"
    lines = table.read_text().splitlines()
    place = next(i for i, line in enumerate(lines) if f"LIDAR_TOP-{RIG.stamp_us(RIG.tokens.index(token))}" in line)
    lines[place] = lines[place].replace("50.0]", "50.5]")
    table.write_text("\n".join(lines) + "\n")


@pytest.mark.parametrize("change", [change_labels, change_sweep, change_pose])
def test_what_has_changed_is_read_anew_and_nothing_else(
    copied: Path, tmp_path: Path, read: list[str], change: object
) -> None:
    cached(copied, tmp_path / "cache")
    read.clear()
    change(copied, RIG.tokens[1])  # type: ignore[operator]
    cached(copied, tmp_path / "cache")
    assert read == [RIG.tokens[1]]


def test_other_inputs_are_other_frames(rig: Path, tmp_path: Path, read: list[str]) -> None:
    cached(rig, tmp_path)
    read.clear()
    cached(rig, tmp_path, replace(INPUTS, image_size_px=(12, 16)))
    assert len(read) == 3


def test_more_earlier_sweeps_need_no_other_cache(rig: Path, tmp_path: Path, read: list[str]) -> None:
    cached(rig, tmp_path)
    read.clear()
    cached(rig, tmp_path, replace(INPUTS, lidar_sweeps=2, earliest_s=0.2))
    assert read == []


def test_a_caching_that_was_cut_off_goes_on(
    rig: Path, tmp_path: Path, read: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = cached(rig, tmp_path / "whole")

    def cut(path: Path, record: FrameRecord) -> None:
        if record.token == RIG.tokens[2]:
            raise KeyboardInterrupt
        write_record(path, record)

    monkeypatch.setattr(cache, "write_record", cut)
    with pytest.raises(KeyboardInterrupt):
        cached_frames(labelled_frames((rig,)), INPUTS, tmp_path / "cache", lambda *_: None, workers=1)
    monkeypatch.setattr(cache, "write_record", write_record)
    read.clear()
    found = cached(rig, tmp_path / "cache")
    assert read == [RIG.tokens[2]]
    assert [frame.sha256 for frame in found] == [frame.sha256 for frame in whole]


def test_a_hash_is_of_content_wherever_and_whenever_it_was_written(rig: Path, copied: Path, tmp_path: Path) -> None:
    for path in copied.rglob("*"):
        os.utime(path, ns=(0, 0))
    one, other = cached(rig, tmp_path / "a"), cached(copied, tmp_path / "b")
    assert [frame.path.name for frame in one] != [frame.path.name for frame in other]
    assert data_hash(one) == data_hash(other) == data_hash(reversed(other))


def test_a_hash_changes_with_content_and_time(copied: Path, tmp_path: Path) -> None:
    before = cached(copied, tmp_path / "a")
    later = (replace(before[0], stamp_us=before[0].stamp_us + 1), *before[1:])
    change_sweep(copied, RIG.tokens[1])
    after = cached(copied, tmp_path / "a")
    assert len({data_hash(frames) for frames in (before, before[:2], later, after)}) == 4


def test_labels_may_lie_beside_samples(rig: Path, copied: Path, tmp_path: Path) -> None:
    bare = write_small_export(tmp_path / "inputs", replace(RIG, is_labelled=False))
    (tmp_path / "version" / "gts").parent.mkdir()
    (copied / "gts").rename(tmp_path / "version" / "gts")
    apart = cached((bare, tmp_path / "version"), tmp_path / "a")
    assert data_hash(apart) == data_hash(cached(rig, tmp_path / "a"))


@pytest.mark.parametrize("root", ["", "stone-1.0/"])
def test_labels_may_lie_in_tars_of_a_version_in_the_same_folder(rig: Path, tmp_path: Path, root: str) -> None:
    folder = tmp_path / "all"
    write_small_export(folder / "field", replace(RIG, is_labelled=False))
    for name, files in (("train", "gts"), ("notes", "v1.0-trainval/scene.json")):
        with tarfile.open(folder / f"{name}.tar", "w") as tar:
            tar.add(rig / files, f"{root}{files}")
    assert data_hash(cached(folder, tmp_path / "a")) == data_hash(cached(rig, tmp_path / "a"))


def test_a_sensor_that_is_missing_is_named(rig: Path, meadow: Path, tmp_path: Path) -> None:
    with refused_as("sensor_missing", match="CAM_REAR"):
        cached(rig, tmp_path, replace(INPUTS, channels=("CAM_FRONT", "CAM_REAR")))
    with refused_as("sensor_missing", match="no radar"):
        cached(meadow, tmp_path, InputConfig("L+R"))


def test_a_damaged_file_is_named_and_not_cached(copied: Path, tmp_path: Path) -> None:
    picture = next((copied / "samples" / "CAM_FRONT").iterdir())
    picture.write_bytes(b"no picture")
    with pytest.raises(DamagedExportError, match=picture.name):
        cached(copied, tmp_path / "cache")
    assert len(list((tmp_path / "cache").glob("*.safetensors"))) <= 2


TABLE_TWO = ("c-conet", "c-openocc", "l-conet", "l-openocc", "m-conet", "m-openocc", "occformer", "occfusion-cl",
             "occfusion-cr", "tpvformer")  # fmt: skip


def test_all_rows_of_the_table_are_shipped() -> None:
    assert set(TABLE_TWO) <= set(known_rows())


@pytest.mark.parametrize("name", known_rows())
def test_a_shipped_row_is_read_and_survives_its_run(name: str, tmp_path: Path) -> None:
    row = read_row(name)
    assert row.name == name
    write_run_row(tmp_path, row)
    assert read_run_row(tmp_path) == row


def test_changes_of_training_are_taken_and_nothing_is_changed_by_none() -> None:
    row = read_row("l-openocc", {"epochs": 3, "seed": None})
    assert row.training.epochs == 3
    assert row.training.seed == read_row("l-openocc").training.seed
    assert differences(row, read_row("l-openocc")).startswith("training.epochs 3, not ")


def test_a_file_of_ones_own_is_a_row(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(json.dumps(row_record()))
    assert read_row(str(path)) == small_row()


def changed(*path: str, to: Any) -> Callable[[dict[str, Any]], None]:
    def change(said: dict[str, Any]) -> None:
        for key in path[:-1]:
            said = said[key]
        said[path[-1]] = to

    return change


LIES: dict[str, tuple[Callable[[dict[str, Any]], None], str]] = {
    "an unknown key": (changed("epoch", to=3), "epoch is not a field"),
    "a misspelt key of training": (changed("training", "learning_rat", to=1), r"training\.learning_rat is not a field"),
    "a misspelt key of the model": (changed("model", "lattice", "shap", to=1), r"model\.lattice\.shap is not a field"),
    "another modality": (changed("inputs", "modality", to="C"), "the modality of the inputs is C, of the model L"),
    "a modality that is none": (changed("inputs", "modality", to="X"), "inputs.modality: .* found 'X'"),
    "pictures of another size": (lambda said: said.update(
        inputs={"modality": "C", "image_size_px": [32, 64]}, model={"architecture": "openocc", "modality": "C"}
    ), r"image_size_px is \(32, 64\), but the model requires \(896, 1600\)"),
    "an architecture that is none": (changed("model", "architecture", to="resnet"), "model"),
    "a text for a number": (changed("training", "epochs", to="many"), r"training\.epochs: .* found 'many'"),
    "a precision that is none": (changed("training", "precision", to="float16"), r"training\.precision"),
    "no method": (lambda said: said.pop("method"), "method"),
}  # fmt: skip


@pytest.mark.parametrize("lie", LIES)
def test_what_says_something_impossible_is_refused(lie: str) -> None:
    said = json.loads(json.dumps(row_record()))
    change, why = LIES[lie]
    change(said)
    with refused_as("bad_row", match=why) as refused:
        row_of("mine", said)
    assert "\n" not in str(refused.value)
    assert "Value error" not in str(refused.value)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("epochs", 0),
        ("batch", 0),
        ("accumulate", -1),
        ("stride", 0),
        ("checkpoint_steps", 0),
        ("learning_rate", -1.0),
        ("least_confidence", 1.5),
    ],
)
def test_counts_below_one_are_refused(key: str, value: float) -> None:
    with refused_as("bad_row", match=key):
        small_row(**{key: value})


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b"", "found 'None'"),
        (b"- a\n- b\n", "found"),
        (b"a: [", "it is not YAML"),
        (b"\xff\xfe\x00", "it is not YAML"),
        (b"a: !!python/object:os.system x\n", "it is not YAML"),
        (b"# " + b"x" * 70_000, "larger than 65536 bytes"),
    ],
)
def test_a_file_that_is_no_row_is_refused(tmp_path: Path, content: bytes, why: str) -> None:
    path = tmp_path / "mine.yaml"
    path.write_bytes(content)
    with refused_as("bad_row", match=why):
        read_row(str(path))


def test_a_row_that_is_not_there_is_refused_with_those_that_are() -> None:
    with refused_as("bad_row"):
        read_row("l-opnocc")
