"""Ranking with confidence: the order of a board, intervals of ranks, paired differences, tie groups.

**Conventions.** Replicates are resampled ratios of entries, (n, D), NaN where undefined; column d is the same resample
for every entry, so differences are paired: the ground that is hard is hard for both, and what remains is between the
two. Ranks count from 1, the largest ratio first. What is undefined in a replicate may have been anything: it widens an
interval and never decides.

Two entries whose separate intervals overlap may well differ surely (Schenker and Gentleman, 2001); so ties are found by
paired tests. Source: percentile intervals, Efron (1979); sign-flip test, Fisher (1935).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stone.errors import ShapeError

LEVEL = 0.95
MOST_EXACT = 16
RANDOM_FLIPS = 2**13
FLIPS_SEED = 0

Replicates = NDArray[np.floating[Any]]
Ranks = NDArray[np.int64]


@dataclass(frozen=True)
class Difference:
    """Of two entries a − b over replicates; `interval` is None where a replicate leaves it undefined.

    `share_above` is that of the replicates in which a > b, ties counted half; `p` the two-sided bootstrap p, in (0, 1].
    """

    interval: tuple[float, float] | None
    share_above: float
    p: float


@dataclass(frozen=True)
class SignFlip:
    """Of differences by sequence; with so few, `smallest_p` is the least that any result could have given."""

    sequences: int
    p: float
    smallest_p: float


def in_order(keys: Sequence[Sequence[float]]) -> list[int]:
    """The entries' places, best first: by the first key falling, then the next; equal ones as they were given."""
    return sorted(range(len(keys)), key=lambda place: [-value for value in keys[place]])


def shared_ranks(keys: Sequence[Sequence[float]]) -> list[int]:
    """The rank of each entry of an order: one more than there are before it with other keys (1, 1, 3)."""
    ranks: list[int] = []
    for place, key in enumerate(keys):
        is_equal = place > 0 and list(key) == list(keys[place - 1])
        ranks.append(ranks[-1] if is_equal else place + 1)
    return ranks


def rank_intervals(replicates: Replicates, level: float = LEVEL) -> Ranks:
    """The central interval of each entry's rank over replicates (n, D): (n, 2), lowest and highest rank, both included.

    Equal entries of a replicate hold all the ranks they share. Raises `ShapeError` where there is no replicate.
    """
    best, worst = _ranks_in_replicates(_checked(replicates))
    low = np.quantile(best, (1 - level) / 2, axis=1, method="inverted_cdf")
    high = np.quantile(worst, (1 + level) / 2, axis=1, method="inverted_cdf")
    return np.stack([low, high], axis=1).astype(np.int64)


def paired(a: Replicates, b: Replicates, level: float = LEVEL) -> Difference:
    """How a differs from b over their common replicates (D,). Raises `ShapeError` where these are not as many."""
    if a.shape != b.shape or a.ndim != 1 or not a.size:
        raise ShapeError("draws", b.shape, f"(D,) as those of the other entry, {a.shape}, with at least one draw")
    difference = a.astype(np.float64) - b.astype(np.float64)
    share, p = _decided(difference)
    if np.isnan(difference).any():
        return Difference(None, share, p)
    low, high = np.quantile(difference, [(1 - level) / 2, (1 + level) / 2])
    return Difference((float(low), float(high)), share, p)


def tie_groups(replicates: Replicates, level: float = LEVEL) -> Ranks:
    """The group (n,) of each entry, from 1, of replicates (n, D) in the order of the board.

    A group begins with the first entry that is surely below the beginning of the group before: whose paired difference
    from it has p ≤ 1 − level. Entries of a group do not surely differ from its first.
    """
    groups = np.ones(len(replicates), np.int64)
    first = 0
    for place in range(1, len(replicates)):
        share, p = _decided(replicates[first] - replicates[place])
        if share > 0.5 and p <= 1 - level:
            first = place
        groups[place] = groups[place - 1] + (first == place)
    return groups


def sign_flip(differences: Sequence[float]) -> SignFlip:
    """The two-sided test that differences by sequence (n,) are as likely to lie the other way round.

    Every way of flipping signs is tried, up to `MOST_EXACT` sequences; beyond, `RANDOM_FLIPS` of them. No p can be
    smaller than 2 / 2^n: of 5 sequences 0.0625, however large the difference. Without a sequence p is 1.
    """
    values = np.asarray(differences, np.float64)
    flips = _flips(len(values))
    sums = flips @ values
    tolerance = 1e-12 * np.abs(values).sum()
    p = float(np.mean(np.abs(sums) >= abs(values.sum()) - tolerance))
    return SignFlip(len(values), p, min(1.0, 2.0 / len(flips)))


def _decided(difference: Replicates) -> tuple[float, float]:
    """The share of replicates above 0, and the two-sided p: equal and undefined ones speak for neither side."""
    above, below = int(np.sum(difference > 0)), int(np.sum(difference < 0))
    replicates = len(difference)
    neither = replicates - above - below
    return (above + neither / 2) / replicates, min(1.0, 2 * (min(above, below) + neither + 1) / (replicates + 1))


def _flips(sequences: int) -> NDArray[np.float64]:
    """Signs (…, n), the unflipped ones among them."""
    if sequences <= MOST_EXACT:
        bits = np.arange(2**sequences)[:, None] >> np.arange(sequences) & 1
        return np.asarray(1.0 - 2.0 * bits)
    signs = np.random.default_rng(FLIPS_SEED).integers(0, 2, (RANDOM_FLIPS, sequences)) * 2.0 - 1.0
    signs[:2] = [[1.0], [-1.0]]
    return np.asarray(signs)


def _ranks_in_replicates(replicates: Replicates) -> tuple[Ranks, Ranks]:
    """The best and the worst rank (n, D) that each entry may have in each replicate."""
    by_replicate = np.ascontiguousarray(replicates.T)
    is_unknown = np.isnan(by_replicate)
    best, worst = np.empty(by_replicate.shape, np.int64), np.empty(by_replicate.shape, np.int64)
    for replicate, values in enumerate(by_replicate):
        known = np.sort(values[~is_unknown[replicate]])
        unknown = len(values) - len(known)
        best[replicate] = 1 + len(known) - np.searchsorted(known, values, "right")
        worst[replicate] = len(known) - np.searchsorted(known, values, "left") + unknown
    best[is_unknown], worst[is_unknown] = 1, by_replicate.shape[1]
    return best.T, worst.T


def _checked(replicates: Replicates) -> Replicates:
    if replicates.ndim != 2 or not replicates.shape[1]:
        raise ShapeError("draws", replicates.shape, "(n, D) with at least one draw")
    return replicates
