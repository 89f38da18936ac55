"""The label grid around the robot, and the block of the labelled map that contains a stretch of frames.

**Conventions.** Grids are those of `stone_base.label_grid`. `stone.labels.crops` cuts grids from a `Window`.
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.geometry.lattice import Keys, indices_of
from stone.geometry.se3 import SE3
from stone.labels.observed_voxels import BRICK, Observed
from stone.labels.voxels import VOXEL_M
from stone_base.label_grid import PAPER, LabelGrid

LOW, HIGH, OCCUPIED, OBSERVED = 1, 2, 4, 8  # bits of a window's voxel
MOST_BYTES = 2**31 - 1  # window positions are 32-bit

Grid = NDArray[np.uint8]
Bounds = tuple[NDArray[np.int64], NDArray[np.int64]]


@dataclass(frozen=True, eq=False)
class Window:
    """A dense block of the map, one byte per voxel.

    `origin` (3,) int64 is the index of the lowest voxel, voxels[1, 1, 1]; the outermost layer on every side is 0 and
    represents all voxels outside. For an `OCCUPIED` voxel, `LOW` and `HIGH` are the bits of its class. For other
    voxels, `LOW` means that a labelled voxel touches it, `HIGH` that one touches it with a side towards x or y.
    """

    origin: NDArray[np.int64]
    voxels: NDArray[np.uint8]


def window_bytes(bounds: Bounds) -> int:
    """Return the size in bytes of the window of this range."""
    return math.prod(_shape(bounds))


def _shape(bounds: Bounds) -> tuple[int, int, int]:
    x, y, height = (int(span) + 2 for span in bounds[1] - bounds[0])
    return x, y, height


def window_of(keys: Keys, classes: NDArray[np.uint8], observed: Observed, bounds: Bounds) -> Window:
    """Return the window of the half-open index range `bounds`, without voxels outside it.

    Raises ValueError for a range of more than `MOST_BYTES`; a frame's range has a fortieth of that.
    """
    if window_bytes(bounds) > MOST_BYTES:
        raise ValueError(f"a window has {window_bytes(bounds)} bytes; the limit is {MOST_BYTES}")
    low, _ = bounds
    voxels = np.zeros(_shape(bounds), np.uint8)
    indices = indices_of(keys) - low
    _put_classes(voxels, indices, classes)
    _put_touching(voxels, indices)
    _put_observed(voxels, indices_of(observed.keys) * BRICK - low, observed.words)
    return Window(low, voxels)


@njit(inline="always")
def _is_inside(voxels, i, j, k):  # type: ignore[no-untyped-def]
    """Return whether the window contains this voxel, counted from its origin."""
    x, y, height = voxels.shape[0] - 2, voxels.shape[1] - 2, voxels.shape[2] - 2
    return (i >= 0) & (i < x) & (j >= 0) & (j < y) & (k >= 0) & (k < height)


@njit(cache=True, nogil=True)
def _put_classes(voxels, indices, classes):  # type: ignore[no-untyped-def]
    for p in range(indices.shape[0]):
        i, j, k = indices[p, 0], indices[p, 1], indices[p, 2]
        if classes[p] and _is_inside(voxels, i, j, k):
            voxels[i + 1, j + 1, k + 1] |= classes[p] | np.uint8(OCCUPIED)


@njit(cache=True, nogil=True)
def _put_touching(voxels, indices):  # type: ignore[no-untyped-def]
    """Set `LOW` and `HIGH` of the voxels around labelled ones; `indices` may include other voxels and voxels
    outside.
    """
    for p in range(indices.shape[0]):
        i, j, k = indices[p, 0], indices[p, 1], indices[p, 2]
        if not _is_inside(voxels, i, j, k) or voxels[i + 1, j + 1, k + 1] & OCCUPIED == 0:
            continue
        for x in range(max(i, 1), min(i + 3, voxels.shape[0] - 1)):
            for y in range(max(j, 1), min(j + 3, voxels.shape[1] - 1)):
                is_beside = (x == i + 1) != (y == j + 1)
                for z in range(max(k, 1), min(k + 3, voxels.shape[2] - 1)):
                    if voxels[x, y, z] & OCCUPIED == 0:
                        voxels[x, y, z] |= LOW | HIGH if is_beside and z == k + 1 else LOW


@njit(cache=True, nogil=True)
def _put_observed(voxels, corners, words):  # type: ignore[no-untyped-def]
    """Set observed voxels: a brick has four voxels in each of sixteen columns, which are four neighbouring bits of its
    word.
    """
    for b in range(corners.shape[0]):
        i, j, k = corners[b, 0], corners[b, 1], corners[b, 2]
        for column in range(BRICK * BRICK):
            bits = (words[b] >> np.uint64(4 * column)) & np.uint64(15)
            x, y = i + (column >> 2), j + (column & 3)
            if bits == 0 or not _is_inside(voxels, x, y, 0):
                continue
            for z in range(max(k, 0), min(k + BRICK, voxels.shape[2] - 2)):
                seen = (bits >> np.uint64(z - k)) & np.uint64(1)
                voxels[x + 1, y + 1, z + 1] |= np.uint8(OBSERVED) if seen else np.uint8(0)


def frame_bounds(map_from_ego: SE3, grid: LabelGrid = PAPER, margin_voxels: int = 2) -> Bounds:
    """Return the half-open range of map voxel indices that the grids at these poses (P,) can touch."""
    low, high = np.array(grid.min_m), np.array(grid.max_m)
    corners = np.array([[(low, high)[(c >> axis) & 1][axis] for axis in range(3)] for c in range(8)])
    corners_map = SE3(map_from_ego.wxyz_xyz[..., None, :]) @ corners
    indices = np.floor(corners_map.reshape(-1, 3) / VOXEL_M).astype(np.int64)
    return indices.min(axis=0) - margin_voxels, indices.max(axis=0) + margin_voxels + 1
