"""Reliability: the difference of claimed and true shares in groups of similar confidence."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

GROUPS = 10
FEWEST = 200  # voxels of a bin of probability; smaller bins are left out
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Reliability:
    """The worst difference of claimed and true shares: in tenths of the `voxels`, and in `bins` of the probability.

    `lowest`: both shares in the tenth of the lowest confidence. `by_probability`: both shares and the voxels of each
    bin.
    """

    voxels: int
    tenths: float
    bins: float
    lowest: tuple[float, float]
    by_probability: tuple[tuple[float, float, int], ...]


def reliability_of(confidence: Array, is_right: NDArray[np.bool_], weight: Array) -> Reliability:
    """Return the reliability of confidences (K,) of labels that are right or not (K,), with weights (K,)."""
    order = np.argsort(confidence, kind="stable")
    before = np.cumsum(weight[order]) - weight[order]
    tenth = np.empty(len(order), np.int64)
    tenth[order] = np.minimum((before / weight.sum() * GROUPS).astype(np.int64), GROUPS - 1)
    by_probability = np.minimum((confidence * GROUPS).astype(np.int64), GROUPS - 1)
    claimed, right, _ = _shares(tenth, confidence, is_right, weight)
    in_bins, right_in_bins, count = _shares(by_probability, confidence, is_right, weight)
    apart = np.abs(in_bins - right_in_bins)[count >= FEWEST]
    worst, lowest = float(np.nanmax(np.abs(claimed - right))), (float(claimed[0]), float(right[0]))
    bins = tuple(zip(in_bins.tolist(), right_in_bins.tolist(), count.tolist(), strict=True))
    return Reliability(len(order), worst, float(apart.max()), lowest, bins)


def _shares(
    group: NDArray[np.int64], confidence: Array, is_right: NDArray[np.bool_], weight: Array
) -> tuple[Array, Array, NDArray[np.int64]]:
    """Return the claimed share of each group, its true share, and its voxels; NaN for an empty group."""
    total = np.bincount(group, weight, GROUPS)
    with np.errstate(invalid="ignore"):
        claimed = np.bincount(group, weight * confidence, GROUPS) / total
        right = np.bincount(group, weight * is_right, GROUPS) / total
    return claimed, right, np.bincount(group, minlength=GROUPS)
