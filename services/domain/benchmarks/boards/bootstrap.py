"""Rank confidence of leaderboard entries, from their bootstrap replicates.

**Conventions.** Replicates are read from the store outside transactions, once: a column of ranked ratios is kept in
memory by the sha256 of its blob, which never changes, and the outcome for a list of entries by theirs. Both are
bounded, so that a process holds at most some 64 MiB. Where resampling changed nothing for anybody (every sequence is
shorter than a block) it tells nothing, and nothing is claimed.
"""

import io
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from threading import Lock
from typing import Any

import numpy as np
from cachetools import LRUCache, cached
from numpy.typing import NDArray

from services.runtime.store.protocol import Store
from stone.scoring.metric import RATIOS
from stone.scoring.ranking import rank_intervals, tie_groups

RANKED_BY = RATIOS.index("miou")
BLOCK, SEQUENCE = "block", "sequence"
READERS = 8
MOST_COLUMNS = 3000
MOST_OUTCOMES = 64

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class RankConfidence:
    """The rank interval and tie group of each ranked entry; null where resampling tells nothing."""

    rank_intervals: tuple[tuple[int, int] | None, ...]
    tie_groups: tuple[int | None, ...]


_COLUMNS: LRUCache[str, Floats] = LRUCache(MOST_COLUMNS)
_OUTCOMES: LRUCache[tuple[str, ...], RankConfidence] = LRUCache(MOST_OUTCOMES)


@cached(_OUTCOMES, key=lambda store, draws, key_of: tuple(draws), lock=Lock())
def rank_confidence_of(store: Store, draws: Sequence[str], key_of: Mapping[str, str]) -> RankConfidence:
    """Of entries in the order of the board, by the sha256 of their replicates; `key_of` tells each one's key."""
    return _rank_confidence(columns(store, draws, key_of))


def columns(store: Store, draws: Sequence[str], key_of: Mapping[str, str]) -> list[Floats]:
    """The block replicates (D,) of the ranked ratio, of each entry."""
    with ThreadPoolExecutor(READERS) as readers:
        return list(readers.map(lambda sha256: _column(store, sha256, key_of[sha256]), draws))


@cached(_COLUMNS, key=lambda store, sha256, object_key: sha256, lock=Lock())
def _column(store: Store, sha256: str, object_key: str) -> Floats:
    return np.ascontiguousarray(read_replicates(store, object_key, BLOCK)[:, RANKED_BY])


def read_replicates(store: Store, object_key: str, kind: str) -> Floats:
    """Replicates (D, 5) of a score; columns are `RATIOS`. Raises `StoreAwayError`."""
    return np.asarray(_member(b"".join(store.read(object_key)), kind), np.float32)


def _member(content: bytes, name: str) -> NDArray[Any]:
    with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
        return np.asarray(arrays[name])


def _rank_confidence(found: list[Floats]) -> RankConfidence:
    is_conclusive = len({column.shape for column in found}) == 1 and any(varies(column) for column in found)
    if not is_conclusive:
        return RankConfidence((None,) * len(found), (None,) * len(found))
    draws = np.stack(found)
    intervals = tuple((low, high) for low, high in rank_intervals(draws).tolist())
    return RankConfidence(intervals, tuple(tie_groups(draws).tolist()))


def varies(draws: Floats) -> bool:
    """Whether resampling changed anything."""
    return bool(len(draws)) and bool(np.any(draws != draws[0]))
