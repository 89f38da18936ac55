"""The devkit opens every layout, and says what a few lines of zipfile, JSON and NumPy say.

Catches alone a dataset that reads otherwise from Python than on the platform, and one that cannot be sent to a worker.
"""

import json
import tarfile
import zipfile
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from io import BytesIO
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial.transform import Rotation

from stone_base.label_grid import PAPER, RELEASE, LabelGrid
from stone_client.devkit import Dataset, Frame, open_dataset
from stone_datasets.placed_frames import swept_frames
from stone_exports.files import FolderFiles
from stone_exports.frames import frames_in
from stone_files.byte_ranges import LocalRanges
from stone_files.dataset_layouts import LAYOUTS
from stone_files.grid_file import grid_text
from stone_submissions.manifest import read_manifest
from testing.refusals import refused_as
from testing.worlds.released_datasets import ReleasedDataset, write_released, write_released_zip

TWIN = ReleasedDataset(scenes=4, frames=3)
END_BYTES = 22 + 2**16  # of a zip: what any reader searches for its end record
Row = Mapping[str, Any]


@dataclass(frozen=True)
class ReadAlone:
    """A dataset in a zip, read by the standard library and NumPy."""

    archive: zipfile.ZipFile
    root: str

    def rows(self, table: str) -> list[dict[str, Any]]:
        return json.loads(self.archive.read(f"{self.root}v1.0-trainval/{table}.json"))  # type: ignore[no-any-return]

    def by_token(self, table: str) -> dict[str, dict[str, Any]]:
        return {row["token"]: row for row in self.rows(table)}

    def data(self, channel: str) -> dict[str, dict[str, Any]]:
        """Rows of sample_data by the token of their frame, with their calibration and pose."""
        sensors, mounts, poses = map(self.by_token, ("sensor", "calibrated_sensor", "ego_pose"))
        rows = [
            row | {"mount": mounts[row["calibrated_sensor_token"]], "pose": poses[row["ego_pose_token"]]}
            for row in self.rows("sample_data")
        ]
        return {row["sample_token"]: row for row in rows if sensors[row["mount"]["sensor_token"]]["channel"] == channel}

    def labels(self, scene: str, token: str) -> dict[str, NDArray[np.uint8]]:
        return dict(np.load(BytesIO(self.archive.read(f"{self.root}gts/{scene}/{token}/labels.npz"))))


def read_alone(path: Path, what: ReleasedDataset) -> ReadAlone:
    return ReadAlone(zipfile.ZipFile(path), what.root)


def matrix(row: Row) -> NDArray[np.float64]:
    found = np.eye(4)
    found[:3, :3] = Rotation.from_quat(row["rotation"], scalar_first=True).as_matrix()
    found[:3, 3] = row["translation"]
    return found


def moved(transform: NDArray[np.float64], points: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    return np.asarray(points[:, :3] @ transform[:3, :3].T + transform[:3, 3])


def share_in_occupied(points_ego: NDArray[np.floating[Any]], frame: Frame) -> float:
    """Of the points in the grid, those in an occupied voxel."""
    places = np.floor((points_ego - frame.grid.min_m) / frame.grid.voxel_m).astype(int)
    i, j, k = places[((places >= 0) & (places < frame.grid.shape)).all(axis=1)].T
    return float((frame.semantics[i, j, k] > 0).mean())


@pytest.fixture(scope="module")
def twin(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_released_zip(tmp_path_factory.mktemp("release") / "STONE.zip", TWIN)


@pytest.fixture(scope="module")
def dataset(twin: Path) -> Dataset:
    return open_dataset(twin)


@pytest.mark.parametrize("name", LAYOUTS)
def test_a_frame_is_what_zipfile_and_numpy_read(tmp_path: Path, name: str) -> None:
    what = replace(TWIN, layout=LAYOUTS[name], scenes=2)
    alone = read_alone(write_released_zip(tmp_path / "world.zip", what), what)
    opened = open_dataset(tmp_path / "world.zip")
    scenes, sweeps, pictures = alone.by_token("scene"), alone.data("LIDAR_TOP"), alone.data("CAM_FRONT_LEFT")
    samples = sorted(alone.rows("sample"), key=lambda row: (scenes[row["scene_token"]]["name"], row["timestamp"]))
    assert (opened.layout, opened.grid, len(opened)) == (name, LAYOUTS[name].grid, 6)
    for sample, frame in zip(samples, opened, strict=True):
        token, scene = sample["token"], scenes[sample["scene_token"]]["name"]
        said = (frame.token, frame.sequence, frame.stamp_ns)
        assert said == (token.replace("-", ""), scene, sample["timestamp"] * 1000)
        labels = alone.labels(scene, token)
        classes = labels["label" if name == "release" else "semantics"]
        assert np.array_equal(frame.observed, classes != 255 if name == "release" else labels["mask_lidar"] == 1)
        assert np.array_equal(frame.semantics, np.where(classes == 255, 0, classes))
        _check_sensors(frame, alone, (sweeps[token], pictures[token]))


def _check_sensors(frame: Frame, alone: ReadAlone, rows: tuple[Row, Row]) -> None:
    lidar, camera = rows
    assert frame.channels == ("CAM_FRONT_LEFT", "LIDAR_TOP")
    assert frame.map_from_ego == pytest.approx(matrix(lidar["pose"]), abs=1e-12)
    assert frame.pose("CAM_FRONT_LEFT") == pytest.approx(matrix(camera["pose"]), abs=1e-12)
    for row in rows:
        (found,) = [one for one in frame.calibration.values() if row["filename"].split("/")[1] == one.channel]
        assert found.ego_from_sensor == pytest.approx(matrix(row["mount"]), abs=1e-12)
        intrinsics = [] if found.intrinsics is None else found.intrinsics.tolist()
        assert intrinsics == row["mount"]["camera_intrinsic"]
    returns = np.frombuffer(alone.archive.read(alone.root + lidar["filename"]), "<f4").reshape(-1, 5)
    returns = returns[np.isfinite(returns).all(axis=1)]
    assert frame.sweep[:, :3] == pytest.approx(moved(matrix(lidar["mount"]), returns), abs=1e-4)
    assert np.array_equal(frame.sweep[:, 3], returns[:, 3])
    picture = Image.open(BytesIO(alone.archive.read(alone.root + camera["filename"]))).convert("RGB")
    assert np.array_equal(frame.image("CAM_FRONT_LEFT"), np.asarray(picture))


def test_zip_folder_and_tar_are_one_dataset(tmp_path: Path, dataset: Dataset) -> None:
    folder = write_released(tmp_path / "folder", TWIN)
    with tarfile.open(tmp_path / "dataset.tar", "w") as tar:
        tar.add(folder, "")
    for path in (folder, tmp_path / "dataset.tar"):
        other = open_dataset(path)
        assert (other.sequences, other.drives, other.layout) == (dataset.sequences, dataset.drives, "release")
        for one, same in zip(dataset, other, strict=True):
            assert one.token == same.token
            assert np.array_equal(one.semantics, same.semantics)
            assert np.array_equal(one.sweep, same.sweep)


def test_returns_lie_in_occupied_voxels_of_their_frame_and_by_the_poses_of_the_next(dataset: Dataset) -> None:
    first, second = dataset[0], dataset[1]
    assert first.map_from_ego is not None
    assert second.map_from_ego is not None
    assert share_in_occupied(first.sweep[:, :3], first) >= 0.99
    second_from_first = np.linalg.inv(second.map_from_ego) @ first.map_from_ego
    near = first.sweep[np.linalg.norm(first.sweep[:, :2], axis=1) < 30]
    assert share_in_occupied(moved(second_from_first, near), second) >= 0.99


def test_sequences_are_selected_by_drive(dataset: Dataset) -> None:
    assert dataset.drives == (("field-0000", "field-0001"), ("field-0002", "field-0003"))
    later = dataset.select(dataset.drives[1])
    assert (len(later), later.sequences, later.drives) == (6, dataset.drives[1], dataset.drives[1:])
    assert [frame.token for frame in later] == [frame.token for frame in dataset[6:]]
    assert later[-1].token == dataset[11].token
    with refused_as("unknown_sequence", match="field-0000"):
        later.select(["field-0000"])
    with pytest.raises(IndexError):
        later[6]


def test_opening_reads_directory_tables_and_one_label_file_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    what = replace(TWIN, is_deflated=False)
    path = write_released_zip(tmp_path / "STONE.zip", what)
    ranges, read_at = list[tuple[int, int]](), LocalRanges.read_at

    def counted(self: LocalRanges, offset: int, count: int) -> bytes:
        ranges.append((offset, count))
        return read_at(self, offset, count)

    monkeypatch.setattr(LocalRanges, "read_at", counted)
    opened = open_dataset(path)
    archive, size = zipfile.ZipFile(path), path.stat().st_size
    tables = [one for one in archive.infolist() if f"{what.root}v1.0-" in one.filename]
    first = archive.getinfo(f"{what.root}gts/field-0000/{what.written(opened[0].token)}/labels.npz")
    wanted = [*tables, first]
    heads = 200 * len(wanted)
    directory = size - archive.start_dir
    assert sum(count for _, count in ranges) <= END_BYTES + directory + sum(one.file_size for one in wanted) + heads
    spans = [(one.header_offset, one.header_offset + one.file_size + 200) for one in wanted]
    for offset, count in ranges:
        inside = any(start <= offset and offset + count <= stop for start, stop in spans)
        assert inside or offset + count > size - END_BYTES - directory, (offset, count)
    ranges.clear()
    assert opened[5].semantics.any()
    labels = archive.getinfo(f"{what.root}gts/field-0001/{what.written(opened[5].token)}/labels.npz")
    assert sum(count for _, count in ranges) <= labels.file_size + 200


def checksums(frame: Frame) -> tuple[str, int, float]:
    return frame.token, int(frame.semantics.sum()), float(frame.sweep.sum())


def test_a_dataset_reads_the_same_in_a_process_of_its_own(dataset: Dataset) -> None:
    """Names are found by hashes that every process has its own of."""
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        (there,) = pool.map(_all_of, [dataset])
    assert there == [checksums(frame) for frame in dataset]


def _all_of(dataset: Dataset) -> list[tuple[str, int, float]]:
    return [checksums(frame) for frame in dataset]


def write_labels(folder: Path, grid: LabelGrid, seed: int) -> dict[str, NDArray[np.uint8]]:
    """Labels of two frames at a grid, as `stone label` lays them out; their classes by token."""
    found = {}
    for number, token in enumerate(("f" * 32, "a" * 32)):
        classes = np.random.default_rng((seed, number)).integers(0, 4, grid.shape, np.uint8)
        path = folder / "gts" / "run" / token / "labels.npz"
        path.parent.mkdir(parents=True)
        np.savez_compressed(path, semantics=classes, mask_lidar=np.uint8(classes > 1), mask_camera=classes * 0)
        found[token] = classes
    (folder / "grid.json").write_text(grid_text(grid))
    return found


def test_a_label_set_has_its_frames_in_time_and_each_of_its_grids(tmp_path: Path) -> None:
    of_grid = {
        PAPER: write_labels(tmp_path, PAPER, 1),
        RELEASE: write_labels(tmp_path / "grids" / "release", RELEASE, 2),
    }
    poses = [[1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]]
    frames = {"tokens": ["f" * 32, "a" * 32], "stamps_ns": ["17", "18"], "map_from_ego": poses}
    (tmp_path / "scene").mkdir()
    (tmp_path / "scene" / "scene.json").write_text(json.dumps({"frames": frames}))
    for grid, opened in ((PAPER, open_dataset(tmp_path)), (RELEASE, open_dataset(tmp_path, grid="release"))):
        assert (opened.grid, opened.sequences) == (grid, ("run",))
        assert [(frame.token, frame.stamp_ns) for frame in opened] == [("f" * 32, 17), ("a" * 32, 18)]
        for frame in opened:
            assert np.array_equal(frame.semantics, of_grid[grid][frame.token])
            assert np.array_equal(frame.observed, frame.semantics > 1)
        turned = np.array([[-1.0, 0, 0, 1], [0, -1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]])
        assert opened[0].map_from_ego == pytest.approx(turned)
    with refused_as("channel_missing", match="label sets have no sensor data"):
        _ = open_dataset(tmp_path)[0].sweep
    with refused_as("not_labels", match="no labels at the grid occ3d"):
        open_dataset(tmp_path, grid="occ3d")


def test_written_labels_are_a_label_set_of_the_frames_that_the_manifest_names(tmp_path: Path, dataset: Dataset) -> None:
    part = dataset.select(dataset.drives[0])
    part.write_labels(tmp_path / "val")
    part.write_manifest(tmp_path / "val.json")
    manifest, written = read_manifest(tmp_path / "val.json"), open_dataset(tmp_path / "val")
    assert (manifest.grid, manifest.tokens) == (RELEASE, tuple(frame.token for frame in part))
    found = {frame.token: frame for frame in written}
    assert (written.grid, found.keys()) == (RELEASE, set(manifest.tokens))
    for frame in part:
        assert np.array_equal(found[frame.token].semantics, frame.semantics)
        assert np.array_equal(found[frame.token].observed, frame.observed)
    with refused_as("output_exists"):
        part.write_labels(tmp_path / "val")


def test_frames_of_a_zip_are_those_of_its_folder(tmp_path: Path, twin: Path) -> None:
    """The folder is read by the reader of exports, which has code of its own for tables."""
    swept = sorted(swept_frames(twin), key=lambda one: (one.sequence, one.stamp_us))
    for frame, same in zip(swept, frames_in(FolderFiles(write_released(tmp_path, TWIN))), strict=True):
        assert (frame.token, frame.sequence, frame.stamp_us) == (same.token, same.sequence, same.stamp_us)
        assert frame.labels is not None
        assert same.labels is not None
        assert frame.labels.read(2**22) == same.labels.read(2**22)
        for channel, datum in same.data.items():
            found = frame.data[channel]
            assert found.stamp_us == datum.stamp_us
            assert found.span.read(2**22) == datum.span.read(2**22)
            assert np.array_equal(found.global_from_ego.wxyz_xyz, datum.global_from_ego.wxyz_xyz)
