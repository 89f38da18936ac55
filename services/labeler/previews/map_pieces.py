"""The labelled map for previews, loaded tile by tile."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone.geometry.corners import corners_of
from stone.geometry.lattice import Keys, indices_of
from stone.labels.voxels import VOXEL_M


@dataclass(frozen=True, eq=False)
class MapPiece:
    """Voxels of one tile: `keys` (K,) sorted, `features` (K, 3) of `stone.surface.terrain`, `classes` (K,) 1 to 3."""

    keys: Keys
    features: NDArray[np.float64]
    classes: NDArray[np.uint8]


Pieces = Sequence[Callable[[], MapPiece]]  # each is loaded more than once, so that memory holds one at a time


@dataclass(frozen=True, eq=False)
class Extent:
    """The half-open range of voxel indices, `low` and `high` (3,), that a map covers."""

    low: NDArray[np.int64]
    high: NDArray[np.int64]

    def low_m(self) -> NDArray[np.float64]:
        return np.asarray(self.low * VOXEL_M, dtype=np.float64)

    def size_m(self) -> NDArray[np.float64]:
        return np.asarray((self.high - self.low) * VOXEL_M, dtype=np.float64)


def extent_of(pieces: Pieces) -> Extent | None:
    """Return the extent, or None for a map without voxels."""
    bounds = None
    for load in pieces:
        keys = load().keys
        if len(keys):
            low, last = corners_of(indices_of(keys))
            high = last + 1
            bounds = (low, high) if bounds is None else (np.minimum(bounds[0], low), np.maximum(bounds[1], high))
    return None if bounds is None else Extent(*bounds)
