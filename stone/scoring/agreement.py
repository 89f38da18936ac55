"""Agreement of two label sets A and B of the same frames: counts of which neither is the truth.

**Conventions.** A confusion is [A, B] over the classes 0 free, 1 traversable (T), 2 potentially traversable (P), 3
non-traversable (N). The ratios of `stone.scoring.confusion` read over all voxels do not change when A and B are
exchanged, so they are those of two label sets as well. The *agreement* is the share of voxels of one class in both,
among the voxels that are occupied in either; undefined (NaN) where neither holds an occupied voxel.

A voxel *differs* in one of four ways, coded as `DIFFERENCES`: occupied in A only, in B only, occupied in both and in B
of a class that is easier to drive (T before P before N), or of one that is harder.
"""

import numpy as np
from numpy.typing import NDArray

from stone.errors import ShapeError
from stone.scoring.confusion import Counts, Ratios
from stone.scoring.metric import CLASSES

Grid = NDArray[np.uint8]

DIFFERENCES = ("both free", "same class", "only in A", "only in B", "easier in B", "harder in B")
BOTH_FREE, SAME, ONLY_A, ONLY_B, EASIER, HARDER = range(len(DIFFERENCES))


def _difference_table() -> NDArray[np.uint8]:
    """The code of each pair of classes (16,), A first."""
    a, b = np.meshgrid(np.arange(CLASSES), np.arange(CLASSES), indexing="ij")
    codes = np.select(
        [(a == 0) & (b == 0), a == b, b == 0, a == 0, b < a], [BOTH_FREE, SAME, ONLY_A, ONLY_B, EASIER], HARDER
    )
    return codes.astype(np.uint8).reshape(-1)


_CODES = _difference_table()


def agreement_ratios(confusions: Counts) -> Ratios:
    """(...,) of confusions (..., 4, 4); NaN where nothing is occupied in either. Raises `ShapeError`."""
    if confusions.shape[-2:] != (CLASSES, CLASSES):
        raise ShapeError("confusions", confusions.shape, f"(..., {CLASSES}, {CLASSES})")
    counts = confusions.astype(np.int64)
    occupied = counts.sum(axis=(-2, -1)) - counts[..., 0, 0]
    same = np.trace(counts, axis1=-2, axis2=-1) - counts[..., 0, 0]
    undefined = np.full(occupied.shape, np.nan)
    return np.asarray(np.divide(same, occupied, out=undefined, where=occupied > 0), dtype=np.float64)


def differences(a: Grid, b: Grid) -> Grid:
    """How each voxel of two grids of classes 0 to 3 differs, coded as `DIFFERENCES`; the shape of both.

    Raises `ShapeError` for grids of different shapes.
    """
    if a.shape != b.shape:
        raise ShapeError("b", b.shape, f"{a.shape}, that of a")
    return _CODES[(a & 3) * CLASSES + (b & 3)]
