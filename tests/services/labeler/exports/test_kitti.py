"""Voxels of SemanticKITTI, read back bit by bit as its own reader does, against the labels they were made of."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from services.labeler.exports.kitti import CONFIG, packed, write_kitti
from stone.geometry.se3 import SE3
from stone_base.label_grid import PAPER
from tests.services.labeler.exports.made import Labelled, unheard


@pytest.fixture(scope="module")
def out(drive: Labelled, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("kitti")
    write_kitti(drive.source(), folder, unheard)
    return folder


def unpacked(path: Path) -> Any:
    """Bit 7 of a byte first, x slowest, z fastest (semantic-kitti-api, auxiliary/SSCDataset.py)."""
    content = np.fromfile(path, np.uint8)
    grid = np.zeros(8 * len(content), np.uint8)
    for bit in range(8):
        grid[bit::8] = content >> (7 - bit) & 1
    return grid.reshape(256, 256, 32)


def matrices(path: Path, keyed: bool = False) -> Any:
    """Lines of twelve numbers as 4 × 4 matrices."""
    lines = [line.split(":")[-1] if keyed else line for line in path.read_text().splitlines()]
    read = np.tile(np.eye(4), (len(lines), 1, 1))
    read[:, :3] = np.array([np.fromstring(line, sep=" ") for line in lines]).reshape(-1, 3, 4)
    return read


def test_every_frame_has_all_that_the_reader_asks_for(out: Path, drive: Labelled) -> None:
    folder, count = out / "dataset" / "sequences" / "00", len(drive.source().sequence.frames)
    for suffix in ("bin", "label", "invalid", "occluded"):
        assert len(list((folder / "voxels").glob(f"*.{suffix}"))) == count
    assert len(list((folder / "velodyne").glob("*.bin"))) == count


def test_labels_and_masks_are_those_of_the_frame(out: Path, drive: Labelled) -> None:
    voxels, source = out / "dataset" / "sequences" / "00" / "voxels", drive.source()
    for index in (0, len(source.sequence.frames) - 1):
        grids = source.grids(index)
        labels = np.fromfile(voxels / f"{index:06d}.label", np.uint16).reshape(256, 256, 32)
        assert np.array_equal(labels, grids["semantics"])
        assert np.array_equal(unpacked(voxels / f"{index:06d}.invalid"), 1 - grids["mask_lidar"])
        assert (labels > 0).any()


def test_a_scan_lies_in_its_voxels(out: Path) -> None:
    folder = out / "dataset" / "sequences" / "00"
    scan = np.fromfile(folder / "velodyne" / "000003.bin", np.float32).reshape(-1, 4)
    occupied, hit = unpacked(folder / "voxels" / "000003.bin"), np.zeros(PAPER.shape, np.uint8)
    for x, y, z, _remission in scan.tolist():
        index = tuple(int(np.floor((p - low) / 0.2)) for p, low in zip((x, y, z), PAPER.min_m, strict=True))
        if all(0 <= i < n for i, n in zip(index, PAPER.shape, strict=True)):
            hit[index] = 1
    # a point on a border may fall to either side of it, rounded to float32
    assert (hit != occupied).sum() <= 2
    assert hit.sum() > 100


def is_hidden(labels: Any, eye: Any, voxel: Any) -> bool:
    """Whether the straight line to a voxel's middle passes through a labelled one, in steps of 4 cm."""
    middle = voxel + 0.5
    steps = int(np.linalg.norm(middle - eye) * 5) + 1
    passed = np.floor(eye + (middle - eye) * np.linspace(0, 1, steps, endpoint=False)[:, None]).astype(int)
    inside = ((passed >= 0) & (passed < np.array(PAPER.shape))).all(axis=1) & (passed != voxel).any(axis=1)
    return bool((labels[tuple(passed[inside].T)] > 0).any())


def test_what_is_occluded_lies_behind_labels_as_straight_rays_see_it(out: Path, drive: Labelled) -> None:
    occluded = unpacked(out / "dataset" / "sequences" / "00" / "voxels" / "000003.occluded")
    source, rng = drive.source(), np.random.default_rng(5)
    eye = (source.sequence.calibration.ego_from_lidar.translation_m - np.array(PAPER.min_m)) / 0.2
    labels, voxels = source.grids(3)["semantics"], rng.integers(0, PAPER.shape, (2000, 3))
    hidden = [is_hidden(labels, eye, voxel) for voxel in voxels]
    agree = occluded[tuple(voxels.T)] == np.array(hidden)
    assert 0.05 < np.mean(hidden) < 0.95
    assert agree.mean() > 0.93


def test_poses_give_back_the_motion_of_the_scans(out: Path, drive: Labelled) -> None:
    folder = out / "dataset" / "sequences" / "00"
    transform = matrices(folder / "calib.txt", keyed=True)[4]
    poses = np.linalg.inv(transform) @ matrices(folder / "poses.txt") @ transform
    map_from_ego: SE3 = drive.source().sequence.frames.map_from_ego
    expected = (map_from_ego[0].inverse() @ map_from_ego).as_matrix()
    np.testing.assert_allclose(poses, expected, atol=1e-9)
    times = np.fromstring((folder / "times.txt").read_text(), sep="\n")
    stamps_ns = drive.source().sequence.frames.stamps_ns
    np.testing.assert_allclose(times, (stamps_ns - stamps_ns[0]) / 1e9, atol=1e-8)


def test_the_configuration_names_the_classes(out: Path) -> None:
    config = yaml.safe_load((out / CONFIG).read_text())
    assert config["labels"] == {0: "free", 1: "traversable", 2: "potentially-traversable", 3: "non-traversable"}
    assert set(config["learning_map"]) == set(config["labels"]) == set(config["color_map"])
    assert config["split"]["train"] == [0]
    assert config["sequences"] == {0: "drive"}


def test_the_first_of_eight_voxels_is_the_highest_bit() -> None:
    grid = np.zeros(16, np.uint8)
    grid[[0, 15]] = 5
    assert packed(grid) == bytes([0b10000000, 0b00000001])
