"""Rank confidence of leaderboard entries, from the spectra kept of their scores.

**Conventions.** Files are read from the store outside transactions, once: what the ranked ratio needs of one is kept in
memory by the sha256 of its blob, which never changes, and the outcome for a list of entries by theirs. Both are
bounded, so that a process holds at most some 16 MiB. The best `MOST_COMPARED` entries are compared; of those below
them, and where of no pair anything can be said, nothing is claimed.
"""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from threading import Lock

import numpy as np
from cachetools import LRUCache, cached

from services.domain.benchmarks.boards.score_spectra import read_spectra
from services.runtime.store.protocol import Store
from stone.scoring.intervals import RatioSpectra
from stone.scoring.metric import RATIOS
from stone.scoring.pairs import board_spectra, surely_above
from stone.scoring.ranking import rank_intervals, tie_groups
from stone.scoring.silences import WITHDRAWN, Silence

RANKED_BY = RATIOS.index("miou")
READERS = 8
MOST_COMPARED = 500
MOST_KEPT = 3000
MOST_OUTCOMES = 64


@dataclass(frozen=True)
class RankConfidence:
    """The rank interval and tie group of each ranked entry; null where nothing is said, `silence` of all of them."""

    rank_intervals: tuple[tuple[int, int] | None, ...]
    tie_groups: tuple[int | None, ...]
    silence: Silence | None = None


@dataclass(frozen=True)
class RankedScore:
    """An entry in the order of the board: its ranked ratio, and the sha256 of the spectra kept of it."""

    value: float
    spectra_sha256: str


_SPECTRA: LRUCache[str, RatioSpectra | None] = LRUCache(MOST_KEPT)
_OUTCOMES: LRUCache[tuple[RankedScore, ...], RankConfidence] = LRUCache(MOST_OUTCOMES)


@cached(_OUTCOMES, key=lambda store, ranked, key_of: tuple(ranked), lock=Lock())
def rank_confidence_of(store: Store, ranked: Sequence[RankedScore], key_of: Mapping[str, str]) -> RankConfidence:
    """Of entries in the order of the board; `key_of` tells each blob's key. Raises `StoreAwayError`."""
    compared = ranked[:MOST_COMPARED]
    with ThreadPoolExecutor(READERS) as readers:
        found = list(readers.map(lambda one: _spectra(store, one.spectra_sha256, key_of[one.spectra_sha256]), compared))
    known = [one for one in found if one is not None]
    if len(known) < len(compared):
        return _silent(ranked, WITHDRAWN)
    if len(ranked) < 2:
        return _silent(ranked, None)
    claims = surely_above(np.array([one.value for one in compared]), board_spectra(known, 0))
    if claims is None:
        return _silent(ranked, "few_frames")
    beneath = (None,) * (len(ranked) - len(compared))
    intervals = ((low, high + len(beneath)) for low, high in rank_intervals(claims).tolist())
    return RankConfidence((*intervals, *beneath), (*tie_groups(claims).tolist(), *beneath))


def _silent(ranked: Sequence[RankedScore], silence: Silence | None) -> RankConfidence:
    nothing = (None,) * len(ranked)
    return RankConfidence(nothing, nothing, silence)


@cached(_SPECTRA, key=lambda store, sha256, object_key: sha256, lock=Lock())
def _spectra(store: Store, sha256: str, object_key: str) -> RatioSpectra | None:
    """Of the ranked ratio alone."""
    found = read_spectra(store, object_key)
    if found is None:
        return None
    column = slice(RANKED_BY, RANKED_BY + 1)
    return RatioSpectra(
        found.layout,
        np.ascontiguousarray(found.coefficients[:, column]),
        np.ascontiguousarray(found.sequence_weight[:, column]),
        found.spread[column].copy(),
    )
