"""What a 4 × 4 confusion says: intersection over union of occupancy and of each traversability class.

**Conventions.** Classes: 0 free, 1 traversable (T), 2 potentially traversable (P), 3 non-traversable (N). Rows are the
ground truth, columns the prediction; counts of voxels, int64 in totals (int32 per frame and ring). Leading axes are
batch axes.

    IoU_occ = |truth occupied ∧ predicted occupied| / |truth occupied ∨ predicted occupied|
    IoU_c   = |truth c ∧ predicted c| / |truth c ∨ predicted c|,  c ∈ {T, P, N},  over all evaluated voxels
    mIoU    = (IoU_T + IoU_P + IoU_N) / 3
    within occupied: the same IoU_c with only the voxels that the ground truth calls occupied.

A ratio over an empty union (the class is in neither) is undefined: NaN in arrays, None in `Ious`; never 0, never 1. A
mean over an undefined part is undefined too: a mean of two classes is not comparable with a mean of three.

Source: Jaccard (1912); the two variants of IoU_c are the two readings of the STONE paper's "within occupied voxels".
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import isnan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stone.bitplanes import CLASSES
from stone.errors import ShapeError
from stone.grid import GRID_SHAPE
from stone.voxels import VOXEL_M

METRIC_VERSION = "stone-iou-1"
CLASS_NAMES = ("free", "T", "P", "N")
OCCUPIED = slice(1, None)

Counts = NDArray[np.integer[Any]]
Ratios = NDArray[np.float64]


@dataclass(frozen=True)
class Ious:
    """The ratios of one confusion, each in [0, 1] or None where undefined."""

    iou_occ: float | None
    iou_t: float | None
    iou_p: float | None
    iou_n: float | None
    miou: float | None


@dataclass(frozen=True)
class Signature:
    """What makes two scores comparable; a board never mixes signatures (after sacrebleu)."""

    ground_truth: str
    mask: str
    metric: str = METRIC_VERSION

    def __str__(self) -> str:
        """`truth` is the first 16 hex digits of the hash of everything that was evaluated."""
        grid = "x".join(map(str, GRID_SHAPE)) + f"@{VOXEL_M}m"
        classes = ",".join(f"{index}={name}" for index, name in enumerate(CLASS_NAMES))
        return f"metric:{self.metric}|truth:{self.ground_truth[:16]}|mask:{self.mask}|grid:{grid}|classes:{classes}"


def confusion_matrix(truth: Counts, prediction: Counts, is_evaluated: NDArray[np.bool_]) -> NDArray[np.int64]:
    """[truth, prediction] (4, 4) of two equal-shaped label arrays 0–3: the plain way, and the oracle of the fast one.

    Raises `ShapeError` where the three shapes differ.
    """
    if not truth.shape == prediction.shape == is_evaluated.shape:
        raise ShapeError("prediction", prediction.shape, f"the shape {truth.shape} of truth and of the mask")
    pairs = truth[is_evaluated].astype(np.int64) * CLASSES + prediction[is_evaluated]
    return np.bincount(pairs, minlength=CLASSES**2).reshape(CLASSES, CLASSES).astype(np.int64)


def iou_occupied(confusion: Counts) -> Ratios:
    """IoU_occ (...,) of confusions (..., 4, 4); NaN where nothing is occupied in either."""
    counts = _checked(confusion)
    both = counts[..., OCCUPIED, OCCUPIED].sum(axis=(-2, -1))
    either = counts.sum(axis=(-2, -1)) - counts[..., 0, 0]
    return _ratio(both, either)


def iou_classes(confusion: Counts) -> Ratios:
    """IoU of T, P, N (..., 3) over all voxels of confusions (..., 4, 4); NaN for a class in neither."""
    counts = _checked(confusion)
    both = np.diagonal(counts, axis1=-2, axis2=-1)[..., OCCUPIED]
    in_truth, in_prediction = counts.sum(axis=-1)[..., OCCUPIED], counts.sum(axis=-2)[..., OCCUPIED]
    return _ratio(both, in_truth + in_prediction - both)


def mean_iou(confusion: Counts) -> Ratios:
    """mIoU (...,) of confusions (..., 4, 4); NaN where one of the three is."""
    return np.asarray(iou_classes(confusion).mean(axis=-1), dtype=np.float64)


def within_occupied(confusion: Counts) -> NDArray[np.int64]:
    """The confusions (..., 4, 4) restricted to voxels that the ground truth calls occupied: row free emptied."""
    counts = _checked(confusion).copy()
    counts[..., 0, :] = 0
    return counts


def ious(confusion: Counts) -> Ious:
    """All ratios of one confusion (4, 4)."""
    parts = [float(iou_occupied(confusion)), *map(float, iou_classes(confusion)), float(mean_iou(confusion))]
    return Ious(*(None if isnan(part) else part for part in parts))


def supports(confusion: Counts) -> Mapping[str, int]:
    """Voxels of each class in the ground truth of one confusion (4, 4)."""
    return dict(zip(CLASS_NAMES, _checked(confusion).sum(axis=-1).tolist(), strict=True))


def _checked(confusion: Counts) -> NDArray[np.int64]:
    if confusion.shape[-2:] != (CLASSES, CLASSES):
        raise ShapeError("confusion", confusion.shape, f"(..., {CLASSES}, {CLASSES})")
    return confusion.astype(np.int64)


def _ratio(part: NDArray[np.int64], whole: NDArray[np.int64]) -> Ratios:
    undefined = np.full(np.shape(whole), np.nan)
    return np.asarray(np.divide(part, whole, out=undefined, where=np.asarray(whole) > 0), dtype=np.float64)
