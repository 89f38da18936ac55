"""Ratios of a 4 × 4 confusion matrix: intersection over union of occupancy and of each traversability class.

**Conventions.** Classes: 0 free, 1 traversable (T), 2 potentially traversable (P), 3 non-traversable (N). Rows are the
ground truth, columns the prediction; counts of voxels, int64 in totals (int32 per frame and ring). Leading axes are
batch axes. Ratios have the order of `stone.scoring.metric.RATIOS`; `stone.scoring.metric` defines them.

A ratio over an empty union (the class is in neither) is undefined: NaN in arrays, None in records; never 0 or 1. A mean
with an undefined part is undefined too, because a mean of two classes is not comparable with a mean of three.

Source: Jaccard (1912); the two metrics are the two readings of the STONE paper's "within occupied voxels".
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import isnan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stone.errors import ShapeError
from stone.scoring.metric import CLASS_NAMES, CLASSES, METRIC_VERSION, RATIOS, metric_of

OCCUPIED = slice(1, None)
T, N = CLASS_NAMES.index("T"), CLASS_NAMES.index("N")
DRIVABLE = slice(T, N)
DANGERS: Mapping[str, int | slice] = {"n_predicted_drivable_ratio": DRIVABLE, "n_predicted_t_ratio": T}

Counts = NDArray[np.integer[Any]]
Ratios = NDArray[np.float64]


@dataclass(frozen=True)
class Extras:
    """Unranked ratios for off-road use; each in [0, 1] or None if undefined.

    Drivable is T or P. `clear_drivable_iou` ignores obstacles above the robot's height; `bev_drivable_iou` does not.
    """

    n_predicted_t_ratio: float | None
    n_predicted_drivable_ratio: float | None
    t_predicted_n_ratio: float | None
    bev_drivable_iou: float | None
    clear_drivable_iou: float | None


def ratios(confusions: Counts, metric: str = METRIC_VERSION) -> Ratios:
    """Return the ratios (..., 5) of confusion matrices (..., 4, 4), NaN if undefined.

    Raises `ShapeError` for other shapes and `unknown_metric`.
    """
    unions, hits = unions_and_hits(confusions, metric)
    of_parts = _ratio(hits, unions)
    return np.concatenate([of_parts, of_parts[..., OCCUPIED].mean(axis=-1, keepdims=True)], axis=-1)


def unions_and_hits(confusions: Counts, metric: str = METRIC_VERSION) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return denominators and numerators (..., 4) of IoU_occ and of the IoU of T, P, N, of confusion matrices (..., 4,
    4).

    Raises `ShapeError` for other shapes and `unknown_metric`.
    """
    counts = _checked(confusions)
    of_classes = within_occupied(counts) if metric_of(metric).is_within_occupied else counts
    parts = (_occupied(counts), _classes(of_classes))
    unions, hits = (np.concatenate(of_both, axis=-1) for of_both in zip(*parts, strict=True))
    return unions, hits


def named_ratios(confusion: Counts, metric: str = METRIC_VERSION) -> dict[str, float | None]:
    """Return the ratios of one confusion matrix (4, 4) by name, None if undefined. Raises the errors of `ratios`."""
    return dict(zip(RATIOS, map(_or_none, ratios(confusion, metric).tolist()), strict=True))


def extras(confusion: Counts, bev: Counts, columns: Counts | None = None) -> Extras:
    """Return the extras of one confusion matrix (4, 4), of columns drivable in (both, truth only, prediction only) (3,)
    and of the confusion matrix of columns (4, 4) from `stone.scoring.columns`.
    """
    counts = _checked(confusion)
    of_truth = counts.sum(axis=-1)
    clear = np.zeros((CLASSES, CLASSES), np.int64) if columns is None else _checked(columns)
    both = clear[DRIVABLE, DRIVABLE].sum()
    either = clear[DRIVABLE].sum() + clear[:, DRIVABLE].sum() - both
    return Extras(
        **danger(counts),
        t_predicted_n_ratio=_or_none(float(_ratio(counts[T, N], of_truth[T]))),
        bev_drivable_iou=_or_none(float(_ratio(bev[0].astype(np.int64), bev.sum(dtype=np.int64)))),
        clear_drivable_iou=_or_none(float(_ratio(both, either))),
    )


def danger(confusion: Counts) -> dict[str, float | None]:
    """Return the shares of the N voxels of one confusion matrix (4, 4) predicted T or P, and T; None without N."""
    of_n = _checked(confusion)[N]
    return {name: _or_none(float(_ratio(of_n[wrong].sum(), of_n.sum()))) for name, wrong in DANGERS.items()}


def tolerant_ratios(confusion: Counts, pairs: Counts) -> dict[str, float | None]:
    """Return the ratios by name of one confusion matrix (4, 4) with pairs (4,) as intersection
    (`stone.scoring.columns`).

    IoU = pairs / (truth voxels + predicted voxels − pairs), over all evaluated voxels.
    """
    counts, hits = _checked(confusion), pairs.astype(np.int64)
    of_truth, of_prediction = counts.sum(axis=1), counts.sum(axis=0)
    of_truth[0], of_prediction[0] = of_truth[OCCUPIED].sum(), of_prediction[OCCUPIED].sum()
    parts = _ratio(hits, of_truth + of_prediction - hits)
    values = [*parts.tolist(), float(parts[OCCUPIED].mean())]
    return dict(zip(RATIOS, map(_or_none, values), strict=True))


def iou_occupied(confusion: Counts) -> Ratios:
    """Return IoU_occ (...,) of confusion matrices (..., 4, 4); NaN if nothing is occupied."""
    union, hit = _occupied(_checked(confusion))
    return _ratio(hit[..., 0], union[..., 0])


def iou_classes(confusion: Counts) -> Ratios:
    """Return the IoU of T, P, N (..., 3) over all voxels of confusion matrices (..., 4, 4); NaN for a class in
    neither.
    """
    union, hit = _classes(_checked(confusion))
    return _ratio(hit, union)


def within_occupied(confusion: Counts) -> NDArray[np.int64]:
    """Return the confusion matrices (..., 4, 4) of voxels that are occupied in the ground truth: row free is 0."""
    counts = _checked(confusion).copy()
    counts[..., 0, :] = 0
    return counts


def supports(confusion: Counts) -> Mapping[str, int]:
    """Return the voxels of each class in the ground truth of one confusion matrix (4, 4)."""
    return dict(zip(CLASS_NAMES, _checked(confusion).sum(axis=-1).tolist(), strict=True))


def _occupied(counts: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return union and hits (..., 1) of occupancy."""
    both = counts[..., OCCUPIED, OCCUPIED].sum(axis=(-2, -1))
    return (counts.sum(axis=(-2, -1)) - counts[..., 0, 0])[..., None], both[..., None]


def _classes(counts: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return union and hits (..., 3) of T, P, N."""
    both = np.diagonal(counts, axis1=-2, axis2=-1)[..., OCCUPIED]
    in_truth, in_prediction = counts.sum(axis=-1)[..., OCCUPIED], counts.sum(axis=-2)[..., OCCUPIED]
    return in_truth + in_prediction - both, both


def _checked(confusion: Counts) -> NDArray[np.int64]:
    if confusion.shape[-2:] != (CLASSES, CLASSES):
        raise ShapeError("confusion", confusion.shape, f"(..., {CLASSES}, {CLASSES})")
    return confusion.astype(np.int64)


def _ratio(part: Counts, whole: Counts) -> Ratios:
    undefined = np.full(np.shape(whole), np.nan)
    return np.asarray(np.divide(part, whole, out=undefined, where=np.asarray(whole) > 0), dtype=np.float64)


def _or_none(ratio: float) -> float | None:
    return None if isnan(ratio) else ratio
