"""A small ground truth on disk, and predictions of it; a benchmark on a platform, one frame a sequence."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from stone.sensors.sequence import frame_token
from stone_base.label_grid import PAPER
from stone_files.npz import npz_bytes
from stone_submissions.ground_truth import find_ground_truth
from stone_submissions.manifest import write_manifest
from testing.worlds import benchmark_world
from testing.worlds.sending import standing_world

Grid = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class World:
    """`folder` holds gts; labels, lidar masks and predictions by token."""

    folder: Path
    manifest_path: Path
    labels: Mapping[str, Grid]
    masks: Mapping[str, Grid]
    predictions: Mapping[str, Grid]


def speckled(seed: int, high: int = 4) -> Grid:
    rng = np.random.default_rng(seed)
    is_set = rng.random(PAPER.shape, dtype=np.float32) < 0.05
    return np.where(is_set, rng.integers(0, high, PAPER.shape), 0).astype(np.uint8)


@pytest.fixture(scope="session")
def world(tmp_path_factory: pytest.TempPathFactory) -> World:
    folder = tmp_path_factory.mktemp("world")
    frames = [("north", 1), ("north", 2), ("south", 3)]
    tokens = [frame_token(name, stamp_ns) for name, stamp_ns in frames]
    labels = {token: speckled(index) for index, token in enumerate(tokens)}
    masks = {token: (speckled(10 + index) == 0).astype(np.uint8) for index, token in enumerate(tokens)}
    errors = {token: speckled(20 + index) for index, token in enumerate(tokens)}
    predictions = {token: np.where(errors[token] > 0, errors[token], labels[token]) for token in tokens}
    for (name, _), token in zip(frames, tokens, strict=True):
        target = folder / "gts" / name / token / "labels.npz"
        target.parent.mkdir(parents=True)
        arrays = {"semantics": labels[token], "mask_lidar": masks[token], "mask_camera": masks[token] * 0}
        target.write_bytes(npz_bytes(arrays))
    manifest_path = folder / "manifest.json"
    write_manifest(manifest_path, find_ground_truth(folder).manifest)
    return World(folder, manifest_path, labels, masks, predictions)


@pytest.fixture(scope="module")
def standing(tmp_path_factory: pytest.TempPathFactory, _sqlite_template: Path) -> Iterator[benchmark_world.World]:
    with standing_world(tmp_path_factory.mktemp("standing"), _sqlite_template) as made:
        yield made
