"""Agreement of two label sets A and B of the same frames; neither is the truth.

**Conventions.** A confusion matrix is [A, B] over the classes 0 free, 1 traversable (T), 2 potentially traversable (P),
3 non-traversable (N). The ratios of `stone.scoring.confusion` over all voxels are symmetric in A and B, so they also
apply to two label sets. The *agreement* is the share of voxels with the same class, among the voxels that are occupied
in A or B; undefined (NaN) if neither has an occupied voxel.

A voxel *differs* in one of four ways, coded as `DIFFERENCES`. It is occupied only in A, only in B, or in both with a
class in B that is easier (T before P before N) or harder to drive.
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
    """Return the code of each pair of classes (16,), A first."""
    a, b = np.meshgrid(np.arange(CLASSES), np.arange(CLASSES), indexing="ij")
    codes = np.select(
        [(a == 0) & (b == 0), a == b, b == 0, a == 0, b < a], [BOTH_FREE, SAME, ONLY_A, ONLY_B, EASIER], HARDER
    )
    return codes.astype(np.uint8).reshape(-1)


_CODES = _difference_table()


def agreement_ratios(confusions: Counts) -> Ratios:
    """Return the agreement (...,) of confusion matrices (..., 4, 4); NaN if nothing is occupied. Raises
    `ShapeError`.
    """
    if confusions.shape[-2:] != (CLASSES, CLASSES):
        raise ShapeError("confusions", confusions.shape, f"(..., {CLASSES}, {CLASSES})")
    counts = confusions.astype(np.int64)
    occupied = counts.sum(axis=(-2, -1)) - counts[..., 0, 0]
    same = np.trace(counts, axis1=-2, axis2=-1) - counts[..., 0, 0]
    undefined = np.full(occupied.shape, np.nan)
    return np.asarray(np.divide(same, occupied, out=undefined, where=occupied > 0), dtype=np.float64)


def differences(a: Grid, b: Grid) -> Grid:
    """Return how each voxel of two grids of classes 0 to 3 differs, coded as `DIFFERENCES`, in their shape.

    Raises `ShapeError` for grids of different shapes.
    """
    if a.shape != b.shape:
        raise ShapeError("b", b.shape, f"{a.shape}, that of a")
    return _CODES[(a & 3) * CLASSES + (b & 3)]
