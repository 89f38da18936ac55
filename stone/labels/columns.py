"""A label grid as upright columns of bits: frames are cut, masked, counted and compared in words instead of voxels.

**Conventions.** A column is the voxels at one position (x, y) of a grid, at most 32. Bit z of its uint32 word is voxel
z; bits above the grid's height are 0. The class of a voxel is its bit of `ones` plus twice its bit of `twos`.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.kernels.lanes import popcount, spread
from stone.labels.grid import Grid
from stone_base.label_grid import PAPER

COLUMN = 32  # bytes written at once
Words = NDArray[np.uint32]


@dataclass(frozen=True, eq=False)
class Columns:
    """The label grid of one frame, each (X, Y) uint32: both bits of the classes, and the observed voxels.

    `filled` is the number of labelled voxels that close a gap (`stone.labels.pinholes`).
    """

    ones: Words
    twos: Words
    observed: Words
    filled: int = 0

    @property
    def occupied(self) -> Words:
        return self.ones | self.twos


def gathered(grid: Grid) -> Words:
    """Return the columns (X, Y) of the voxels that are not 0 in the grid, at most 32 voxels high."""
    packed = np.zeros((*grid.shape[:2], COLUMN // 8), np.uint8)
    bits = np.packbits(grid != 0, axis=-1, bitorder="little")
    packed[..., : bits.shape[-1]] = bits
    return packed.view("<u4")[..., 0]


@lru_cache(maxsize=4)
def nothing(shape: tuple[int, ...]) -> Words:
    """Return read-only empty columns of this shape."""
    return np.zeros(shape, np.uint32)


def spread_out(ones: Words, twos: Words | None = None, out: Grid | None = None, height: int = PAPER.shape[2]) -> Grid:
    """Return (in `out`) the grid of this height whose voxels are their bit of `ones` plus twice their bit of `twos`."""
    grid = np.empty((*ones.shape, height), np.uint8) if out is None else out
    both = ones, nothing(ones.shape) if twos is None else twos
    _spread(both[0].reshape(-1), both[1].reshape(-1), grid.shape[-1], grid.reshape(-1))
    return grid


@njit(cache=True, nogil=True)
def _spread(ones, twos, height, out):  # type: ignore[no-untyped-def]
    """Write each column as 32 bytes at once; the next column overwrites the excess, and the last columns are written by
    byte.
    """
    whole = min(ones.size, (out.size - COLUMN) // height + 1)
    for column in range(whole):
        spread(ones[column], twos[column], out, height * column)
    for column in range(whole, ones.size):
        for z in range(height):
            bit = np.uint32(z)
            two = np.uint32(2) * (twos[column] >> bit & np.uint32(1))
            out[height * column + z] = (ones[column] >> bit & np.uint32(1)) + two


@dataclass(frozen=True, eq=False)
class Masks:
    """The masks of one frame, (X, Y) uint32 each: observed voxels, and voxels that cameras see; and their counts.

    `by_class` (4,) counts the voxels of each class, `by_mask` (2,) the voxels of each mask.
    """

    observed: Words
    visible: Words
    by_class: NDArray[np.int64]
    by_mask: NDArray[np.int64]


def reconcile(columns: Columns, visible: Words, height: int = PAPER.shape[2]) -> Masks:
    """Make the masks of a grid of this height consistent: labelled voxels are observed, and cameras see only observed
    voxels.
    """
    shape = columns.ones.shape
    masks = Masks(np.empty(shape, np.uint32), np.empty(shape, np.uint32), np.zeros(4, np.int64), np.zeros(2, np.int64))
    words = [each.reshape(-1) for each in (columns.ones, columns.twos, columns.observed, visible)]
    _reconcile(tuple(words), (masks.observed.reshape(-1), masks.visible.reshape(-1)), (masks.by_class, masks.by_mask))
    masks.by_class[0] = height * columns.ones.size - masks.by_class[1:].sum()
    return masks


@njit(cache=True, nogil=True)
def _reconcile(words, masks, counts):  # type: ignore[no-untyped-def]
    (low_plane, high_plane, observed, visible), (by_class, by_mask) = words, counts
    for column in range(low_plane.size):
        low, high = low_plane[column], high_plane[column]
        seen = observed[column] | low | high
        masks[0][column], masks[1][column] = seen, seen & visible[column]
        for kind, word in enumerate((low & ~high, high & ~low, low & high)):
            by_class[kind + 1] += np.int64(popcount(np.uint64(word)))
        by_mask[0] += np.int64(popcount(np.uint64(seen)))
        by_mask[1] += np.int64(popcount(np.uint64(seen & visible[column])))
