"""Ranking with confidence: the order of a board, rank intervals, tie groups, the sign-flip test.

**Conventions.** Ranks count from 1, the largest ratio first. `above` (n, n) contains which entry is significantly
better than which (`pairs.py`), at one level for all pairs jointly, so rank intervals and tie groups hold jointly too.

Two entries with overlapping separate intervals may differ significantly (Schenker and Gentleman, 2001), so ties are
determined by pairs. Source: rank intervals from pairs, Mogstad et al. (2024); sign-flip test, Fisher (1935).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

MOST_EXACT = 16
RANDOM_FLIPS = 2**13
FLIPS_SEED = 0

Claims = NDArray[np.bool_]
Ranks = NDArray[np.int64]


@dataclass(frozen=True)
class SignFlip:
    """The result for differences by sequence; `smallest_p` is the smallest possible p for this number of sequences."""

    sequences: int
    p: float
    smallest_p: float


def in_order(keys: Sequence[Sequence[float]]) -> list[int]:
    """Return the entries' indices, best first: by the first key descending, then the next; ties keep their order."""
    return sorted(range(len(keys)), key=lambda index: [-value for value in keys[index]])


def shared_ranks(keys: Sequence[Sequence[float]]) -> list[int]:
    """Return the rank of each entry of an order: one more than the number of entries before it with other keys (1, 1,
    3).
    """
    ranks: list[int] = []
    for index, key in enumerate(keys):
        is_equal = index > 0 and list(key) == list(keys[index - 1])
        ranks.append(ranks[-1] if is_equal else index + 1)
    return ranks


def rank_intervals(above: Claims) -> Ranks:
    """Return the lowest and the highest possible rank (n, 2) of each entry, both included."""
    return np.stack([1 + above.sum(axis=0), len(above) - above.sum(axis=1)], axis=1).astype(np.int64)


def tie_groups(above: Claims) -> Ranks:
    """Return the group (n,) of each entry, from 1, for entries in board order.

    A group starts with the first entry that is significantly below the start of the previous group. Entries of a group
    do not differ significantly from its first entry.
    """
    groups = np.ones(len(above), np.int64)
    first = 0
    for entry in range(1, len(above)):
        if above[first, entry]:
            first = entry
        groups[entry] = groups[entry - 1] + (first == entry)
    return groups


def sign_flip(differences: Sequence[float]) -> SignFlip:
    """Return the two-sided test that the signs of the differences by sequence (n,) are random.

    All sign flips are evaluated for up to `MOST_EXACT` sequences, `RANDOM_FLIPS` random ones for more. No p can be
    smaller than 2 / 2^n: 0.0625 for 5 sequences, however large the difference. Without a sequence p is 1.
    """
    values = np.asarray(differences, np.float64)
    flips = _flips(len(values))
    sums = flips @ values
    tolerance = 1e-12 * np.abs(values).sum()
    p = float(np.mean(np.abs(sums) >= abs(values.sum()) - tolerance))
    return SignFlip(len(values), p, min(1.0, 2.0 / len(flips)))


def _flips(sequences: int) -> NDArray[np.float64]:
    """Return signs (…, n), including the unflipped ones."""
    if sequences <= MOST_EXACT:
        bits = np.arange(2**sequences)[:, None] >> np.arange(sequences) & 1
        return np.asarray(1.0 - 2.0 * bits)
    signs = np.random.default_rng(FLIPS_SEED).integers(0, 2, (RANDOM_FLIPS, sequences)) * 2.0 - 1.0
    signs[:2] = [[1.0], [-1.0]]
    return np.asarray(signs)
