"""The labelled voxels of a label set's whole map, and the differences of two such maps."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import zstandard
from numpy.typing import NDArray

from stone.geometry.lattice import Keys, centres_of, keys_from_indices
from stone.geometry.se3 import Array
from stone.labels.traversability import NON_TRAVERSABLE
from stone.labels.voxels import VOXEL_M

Figures = dict[str, float | str | None]


@dataclass(frozen=True, eq=False)
class LabelledMap:
    """The voxels of the first map, sorted by key: keys (K,) and classes (K,)."""

    keys: Keys
    classes: NDArray[np.uint8]

    @cached_property
    def centres_map(self) -> Array:
        """The centres (K, 3)."""
        return centres_of(self.keys, VOXEL_M)


def read_map(labels: Path) -> LabelledMap:
    """Return the labelled map of a label set, from the viewer's `STT1` files (`services/domain/viewer/formats.py`)."""
    parts = [_tile(path) for path in sorted((labels / "scene").glob("tile_*.bin")) if path.stem.count("_") == 2]
    keys = np.concatenate([np.zeros(0, np.int64), *(keys for keys, _ in parts)])
    classes = np.concatenate([np.zeros(0, np.uint8), *(classes for _, classes in parts)])
    order = np.argsort(keys)
    return LabelledMap(keys[order], classes[order])


def _tile(path: Path) -> tuple[Keys, NDArray[np.uint8]]:
    content = zstandard.ZstdDecompressor().decompress(path.read_bytes())
    count = int(np.frombuffer(content, "<u4", 1, 4)[0])
    indices = np.frombuffer(content, "<i4", 3 * count, 8).reshape(3, count).T
    return keys_from_indices(indices), np.frombuffer(content, np.uint8, count, 8 + 12 * count)


def disagreement(first: LabelledMap, second: LabelledMap) -> tuple[float | None, float | None]:
    """Return shares of the voxels that both label: with different classes, and with N in only one of them."""
    _, mine, theirs = np.intersect1d(first.keys, second.keys, assume_unique=True, return_indices=True)
    ours, others = first.classes[mine], second.classes[theirs]
    return share(ours != others), share((ours == NON_TRAVERSABLE) != (others == NON_TRAVERSABLE))


def share(hits: NDArray[np.bool_]) -> float | None:
    """Return the share of true values; None without values."""
    return float(hits.mean()) if len(hits) else None
