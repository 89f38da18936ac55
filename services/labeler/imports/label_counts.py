"""Counts of a frame's labels: voxels by class, and set voxels of a mask, eight voxels at a time."""

import numpy as np
from numba import njit

from stone.kernels.lanes import popcount
from stone.labels.grid import Grid

LOWEST = np.uint64(0x0101010101010101)


def class_counts(classes: Grid) -> list[int]:
    """Return the numbers of free, T, P and N voxels; the grid has no value above 3."""
    counts = np.zeros(4, np.int64)
    _count(_words(classes), counts)
    counts[0] = classes.size - counts[1:].sum()
    return counts.tolist()


def set_count(mask: Grid) -> int:
    """Return the number of voxels that are 1; all others are 0."""
    counts = np.zeros(4, np.int64)
    _count(_words(mask), counts)
    return int(counts[1])


def _words(grid: Grid) -> np.ndarray[tuple[int, ...], np.dtype[np.uint64]]:
    return np.require(grid.reshape(-1), requirements=("C", "A")).view(np.uint64)


@njit(cache=True, nogil=True)
def _count(words, counts):  # type: ignore[no-untyped-def]
    first, two, both = np.int64(0), np.int64(0), np.int64(0)
    for word in words:
        if word != 0:
            low, high = word & LOWEST, (word >> np.uint64(1)) & LOWEST
            first += np.int64(popcount(low & ~high))
            two += np.int64(popcount(high & ~low))
            both += np.int64(popcount(low & high))
    counts[1], counts[2], counts[3] = first, two, both
