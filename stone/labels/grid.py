"""The label grid around the robot, and the block of the labelled map that a stretch of frames is cut from.

**Conventions.** The grid is ego-aligned: `GRID_MIN_M` to `GRID_MAX_M`, voxels of `VOXEL_M`, shape `GRID_SHAPE`, axes
x, y, z, C order. `stone.labels.crops` cuts it out of a `Window`.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.geometry.lattice import Keys, indices_of
from stone.geometry.se3 import SE3
from stone.labels.observed_voxels import BRICK, Observed
from stone.labels.voxels import VOXEL_M
from stone_base.label_grid import GRID_MAX_M as GRID_MAX_M
from stone_base.label_grid import GRID_MIN_M as GRID_MIN_M
from stone_base.label_grid import GRID_SHAPE as GRID_SHAPE

LOW, HIGH, OCCUPIED, OBSERVED = range(4)  # the planes of a window
BELOW = 32  # bits of a column under the window's lowest voxel, always 0

Grid = NDArray[np.uint8]
Bounds = tuple[NDArray[np.int64], NDArray[np.int64]]


@dataclass(frozen=True, eq=False)
class Window:
    """A dense block of the map, four bits a voxel.

    `origin` (3,) int64 is the index of the lowest voxel. `planes` (X, Y, W, 4) uint32: bit (z + `BELOW`) of the W words
    of a column. Where `OCCUPIED`, the class is `LOW` + 2 · `HIGH`; elsewhere `LOW` says that a labelled voxel touches
    this one, and `HIGH` that one does so with a side towards x or y.
    """

    origin: NDArray[np.int64]
    height: int
    planes: NDArray[np.uint32]


def window_bytes(bounds: Bounds) -> int:
    """What the window of this range weighs."""
    x, y, height = (int(span) for span in bounds[1] - bounds[0])
    return x * y * _words(height) * 16


def _words(height: int) -> int:
    """How many words hold a column, so that the 32 bits from any of its heights on lie in two of them."""
    return ((height + BELOW) >> 5) + 2


def window_of(keys: Keys, classes: NDArray[np.uint8], observed: Observed, bounds: Bounds) -> Window:
    """The window of the half-open index range `bounds`; voxels outside it are left out."""
    low, high = bounds
    x, y, height = (int(span) for span in high - low)
    planes = np.zeros((x, y, _words(height), 4), np.uint32)
    _put_classes(planes, height, indices_of(keys) - low, classes)
    _put_touching(planes)
    _put_observed(planes, height, indices_of(observed.keys) * BRICK - low, observed.words)
    return Window(low, height, planes)


@njit(cache=True, nogil=True)
def _put_classes(planes, height, indices, classes):  # type: ignore[no-untyped-def]
    for p in range(indices.shape[0]):
        i, j, k = indices[p, 0], indices[p, 1], indices[p, 2]
        if not (0 <= i < planes.shape[0] and 0 <= j < planes.shape[1] and 0 <= k < height):
            continue
        word, bit = (k + BELOW) >> 5, np.uint32(1) << np.uint32((k + BELOW) & 31)
        if classes[p] & 1:
            planes[i, j, word, LOW] |= bit
        if classes[p] & 2:
            planes[i, j, word, HIGH] |= bit
        if classes[p]:
            planes[i, j, word, OCCUPIED] |= bit


@njit(cache=True, nogil=True)
def _put_touching(planes):  # type: ignore[no-untyped-def]
    """Fill in `LOW` and `HIGH` of the voxels that are not labelled."""
    for i in range(planes.shape[0]):
        for j in range(planes.shape[1]):
            for word in range(1, planes.shape[2] - 1):
                here = planes[i, j, word, OCCUPIED]
                if here == 0:
                    continue
                for di in range(-1, 2):
                    for dj in range(-1, 2):
                        if 0 <= i + di < planes.shape[0] and 0 <= j + dj < planes.shape[1]:
                            _touch(planes[i + di, j + dj], word, here, (di == 0) != (dj == 0))


@njit(inline="always")
def _touch(column, word, here, is_beside):  # type: ignore[no-untyped-def]
    """Mark what labelled voxels, the bits of `here`, touch in this column."""
    column[word - 1, LOW] |= (here << np.uint32(31)) & ~column[word - 1, OCCUPIED]
    column[word, LOW] |= (here | (here << np.uint32(1)) | (here >> np.uint32(1))) & ~column[word, OCCUPIED]
    column[word + 1, LOW] |= (here >> np.uint32(31)) & ~column[word + 1, OCCUPIED]
    if is_beside:
        column[word, HIGH] |= here & ~column[word, OCCUPIED]


@njit(cache=True, nogil=True)
def _put_observed(planes, height, corners, words):  # type: ignore[no-untyped-def]
    """A brick holds four voxels of each of sixteen columns, four neighbouring bits of its word for each."""
    for b in range(corners.shape[0]):
        bottom = corners[b, 2]
        if bottom <= -BRICK or bottom >= height:
            continue
        kept = np.uint64(15)
        if bottom < 0:
            kept &= np.uint64(15) << np.uint64(-bottom)
        if bottom + BRICK > height:
            kept &= np.uint64(15) >> np.uint64(bottom + BRICK - height)
        word, shift = (bottom + BELOW) >> 5, np.uint64((bottom + BELOW) & 31)
        for column in range(BRICK * BRICK):
            i, j = corners[b, 0] + (column >> 2), corners[b, 1] + (column & 3)
            if not (0 <= i < planes.shape[0] and 0 <= j < planes.shape[1]):
                continue
            bits = ((words[b] >> np.uint64(4 * column)) & kept) << shift
            planes[i, j, word, OBSERVED] |= np.uint32(bits & np.uint64(0xFFFFFFFF))
            planes[i, j, word + 1, OBSERVED] |= np.uint32(bits >> np.uint64(32))


def frame_bounds(map_from_ego: SE3, margin_voxels: int = 2) -> Bounds:
    """The half-open range of map voxel indices that the grids at these poses (P,) can touch."""
    low, high = np.array(GRID_MIN_M), np.array(GRID_MAX_M)
    corners = np.array([[(low, high)[(c >> axis) & 1][axis] for axis in range(3)] for c in range(8)])
    corners_map = SE3(map_from_ego.wxyz_xyz[..., None, :]) @ corners
    indices = np.floor(corners_map.reshape(-1, 3) / VOXEL_M).astype(np.int64)
    return indices.min(axis=0) - margin_voxels, indices.max(axis=0) + margin_voxels + 1
