"""A label grid as upright columns of bits: a frame is cut, hidden, counted and compared in words, not in voxels.

**Conventions.** A column is the 32 voxels over one place (x, y) of the grid of `stone.labels.grid`; bit z of its uint32
word stands for voxel z. The class of a voxel is its bit of `ones` plus twice its bit of `twos`.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.kernels.lanes import popcount, spread
from stone.labels.grid import GRID_SHAPE, Grid

Words = NDArray[np.uint32]
SHAPE = GRID_SHAPE[:2]
NOTHING = np.zeros(SHAPE, np.uint32)


@dataclass(frozen=True, eq=False)
class Columns:
    """The label grid of one frame, each (256, 256) uint32: both bits of the classes, and what was observed.

    `filled` of its labelled voxels close a gap (`stone.labels.pinholes`).
    """

    ones: Words
    twos: Words
    observed: Words
    filled: int = 0

    @property
    def occupied(self) -> Words:
        return self.ones | self.twos


def gathered(grid: Grid) -> Words:
    """The columns (256, 256) in which those voxels are set that are not 0 in the grid."""
    return np.packbits(grid != 0, axis=-1, bitorder="little").view("<u4")[..., 0]


def spread_out(ones: Words, twos: Words = NOTHING, out: Grid | None = None) -> Grid:
    """The grid (`out` if given), of `GRID_SHAPE`, whose voxels are their bit of `ones` plus twice that of `twos`."""
    grid = np.empty(GRID_SHAPE, np.uint8) if out is None else out
    _spread(ones.reshape(-1), twos.reshape(-1), grid.reshape(-1))
    return grid


@njit(cache=True, nogil=True)
def _spread(ones, twos, out):  # type: ignore[no-untyped-def]
    for column in range(ones.size):
        spread(ones[column], twos[column], out, 32 * column)


@dataclass(frozen=True, eq=False)
class Masks:
    """What was observed and what cameras see of one frame, (256, 256) uint32 each, and how much that is.

    `by_class` (4,) counts the voxels of each class, `by_mask` (2,) those of each mask.
    """

    observed: Words
    visible: Words
    by_class: NDArray[np.int64]
    by_mask: NDArray[np.int64]


def reconcile(columns: Columns, visible: Words) -> Masks:
    """Make the masks agree: what is labelled was observed, and cameras vouch for no voxel that no ray reached."""
    masks = Masks(np.empty(SHAPE, np.uint32), np.empty(SHAPE, np.uint32), np.zeros(4, np.int64), np.zeros(2, np.int64))
    words = [each.reshape(-1) for each in (columns.ones, columns.twos, columns.observed, visible)]
    _reconcile(tuple(words), (masks.observed.reshape(-1), masks.visible.reshape(-1)), (masks.by_class, masks.by_mask))
    return masks


@njit(cache=True, nogil=True)
def _reconcile(words, masks, counts):  # type: ignore[no-untyped-def]
    (ones, twos, observed, visible), (by_class, by_mask) = words, counts
    for column in range(ones.size):
        one, two = ones[column], twos[column]
        seen = observed[column] | one | two
        masks[0][column], masks[1][column] = seen, seen & visible[column]
        for kind, word in enumerate((one & ~two, two & ~one, one & two)):
            by_class[kind + 1] += np.int64(popcount(np.uint64(word)))
        by_mask[0] += np.int64(popcount(np.uint64(seen)))
        by_mask[1] += np.int64(popcount(np.uint64(seen & visible[column])))
    by_class[0] = 32 * ones.size - by_class[1:].sum()
