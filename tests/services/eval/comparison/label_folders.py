"""Folders of labels by hand, for comparisons."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stone_files.npz import npz_bytes

SHAPE = (256, 256, 32)
TOKENS = tuple(f"{number:032x}" for number in range(1, 4))
Grid = NDArray[np.uint8]


def random_grid(seed: int, occupied_ratio: float = 0.05) -> Grid:
    """Classes 1 to 3 in so many of the voxels, free elsewhere."""
    rng = np.random.default_rng(seed)
    grid = rng.integers(1, 4, SHAPE, dtype=np.uint8)
    grid[rng.random(SHAPE, dtype=np.float32) >= occupied_ratio] = 0
    return grid


def write_labels(folder: Path, frames: Mapping[str, Mapping[str, Grid]], sequence: str = "forest") -> Path:
    """`gts/<sequence>/<token>/labels.npz` of these arrays."""
    for token, arrays in frames.items():
        path = folder / "gts" / sequence / token / "labels.npz"
        path.parent.mkdir(parents=True)
        path.write_bytes(npz_bytes(arrays))
    return folder
