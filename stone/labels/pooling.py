"""Pooling: converts columns of map-size voxels to the columns of a grid with larger voxels.

**Conventions.** A voxel of n map voxels per side is occupied if any of its n³ voxels is. Its class is the most frequent
class of the occupied ones; ties go to the highest class (N before P before T). It is observed if any of its n³ voxels
is observed or occupied.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.kernels.lanes import popcount
from stone.labels.columns import Columns, spread_out
from stone_base.label_grid import LabelGrid


def pooled(fine: Columns, grid: LabelGrid) -> Columns:
    """Return the columns of the grid, from the columns of `grid.on_map`."""
    if grid.pooled == 1:
        return fine
    low_plane, high_plane, observed = np.zeros((3, *grid.shape[:2]), np.uint32)
    _pool((fine.ones, fine.twos, fine.observed), grid.pooled, grid.shape[2], (low_plane, high_plane, observed))
    return Columns(low_plane, high_plane, observed, fine.filled)


@njit(cache=True, nogil=True)
def _pool(fine, side, height, out):  # type: ignore[no-untyped-def]
    (low_plane, high_plane, observed), (low, high, seen) = fine, out
    cell = np.uint64((1 << side) - 1)
    for a in range(low.shape[0]):
        for b in range(low.shape[1]):
            any_one, any_two, any_seen = np.uint32(0), np.uint32(0), np.uint32(0)
            for u in range(a * side, (a + 1) * side):
                for v in range(b * side, (b + 1) * side):
                    any_one |= low_plane[u, v]
                    any_two |= high_plane[u, v]
                    any_seen |= observed[u, v]
            occupied = np.uint64(any_one | any_two)
            any_seen |= any_one | any_two
            for c in range(height):
                shift = np.uint64(c * side)
                seen[a, b] |= np.uint32((np.uint64(any_seen) >> shift & cell) != 0) << np.uint32(c)
                if occupied >> shift & cell:
                    kind = _class_of(low_plane, high_plane, (a * side, b * side, cell << shift), side)
                    low[a, b] |= np.uint32(kind & 1) << np.uint32(c)
                    high[a, b] |= np.uint32(kind >> 1) << np.uint32(c)


@njit(inline="always")
def _class_of(ones, twos, cube, side):  # type: ignore[no-untyped-def]
    """Return the most frequent class of a cube's occupied voxels; ties go to the highest class."""
    first, second, mask = cube
    t = p = n = np.uint64(0)
    for u in range(first, first + side):
        for v in range(second, second + side):
            low, high = np.uint64(ones[u, v]) & mask, np.uint64(twos[u, v]) & mask
            t += popcount(low & ~high)
            p += popcount(high & ~low)
            n += popcount(low & high)
    if n >= p and n >= t:
        return 3
    return 2 if p >= t else 1


def pooled_further(
    fine: Columns, columns: Columns, further: Mapping[str, NDArray[Any]], grid: LabelGrid
) -> dict[str, NDArray[Any]]:
    """Return further arrays with the grid's shape, by name, from arrays of `grid.on_map`. Each voxel is the mean of its
    map voxels with the same class; without a surface, of all its map voxels.
    """
    n, (x, y, z) = grid.pooled, grid.shape
    cubes, height = (x, n, y, n, z, n), n * z
    classes, own = spread_out(fine.ones, fine.twos, height=height), spread_out(columns.ones, columns.twos, height=z)
    is_used = classes.reshape(cubes) == own[:, None, :, None, :, None]
    counts = is_used.sum(axis=(1, 3, 5))
    return {name: _mean(values.reshape(cubes), is_used, counts) for name, values in further.items()}


def _mean(values: NDArray[Any], is_used: NDArray[np.bool_], counts: NDArray[np.int64]) -> NDArray[Any]:
    mean: NDArray[np.float64] = np.where(is_used, values, 0).sum(axis=(1, 3, 5), dtype=np.float64) / counts
    return np.asarray(np.rint(mean) if values.dtype == np.uint8 else mean, dtype=values.dtype)
