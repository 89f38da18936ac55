"""Ranking with confidence: the order of a board, intervals of ranks, tie groups, the sign-flip test.

**Conventions.** Ranks count from 1, the largest ratio first. `above` (n, n) says which entry surely does better than
which (`pairs.py`), with one level for all pairs together, so that what is read from it here holds together too.

Two entries whose separate intervals overlap may well differ surely (Schenker and Gentleman, 2001); so ties are found by
pairs. Source: rank intervals from pairs, Mogstad et al. (2024); sign-flip test, Fisher (1935).
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


def rank_intervals(above: Claims) -> Ranks:
    """The lowest and the highest rank (n, 2) that each entry may have, both included."""
    return np.stack([1 + above.sum(axis=0), len(above) - above.sum(axis=1)], axis=1).astype(np.int64)


def tie_groups(above: Claims) -> Ranks:
    """The group (n,) of each entry, from 1, of entries in the order of the board.

    A group begins with the first entry that is surely below the beginning of the group before. Entries of a group do
    not surely differ from its first.
    """
    groups = np.ones(len(above), np.int64)
    first = 0
    for place in range(1, len(above)):
        if above[first, place]:
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


def _flips(sequences: int) -> NDArray[np.float64]:
    """Signs (…, n), the unflipped ones among them."""
    if sequences <= MOST_EXACT:
        bits = np.arange(2**sequences)[:, None] >> np.arange(sequences) & 1
        return np.asarray(1.0 - 2.0 * bits)
    signs = np.random.default_rng(FLIPS_SEED).integers(0, 2, (RANDOM_FLIPS, sequences)) * 2.0 - 1.0
    signs[:2] = [[1.0], [-1.0]]
    return np.asarray(signs)
