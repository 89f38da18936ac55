"""How surely the entries of a board are apart, from their kept draws.

**Conventions.** Draws are read from the store outside transactions, once: a column of ranked ratios is kept in memory
by the sha256 of its blob, which never changes, and the outcome for a list of entries by theirs. Both are bounded, so
that a process holds at most some 64 MiB. Where resampling changed nothing for anybody (every sequence is shorter than
a block) it tells nothing, and nothing is claimed.
"""

import io
from collections import OrderedDict
from collections.abc import Callable, Hashable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from threading import Lock
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from services.runtime.store import Store
from stone.metric import RATIOS
from stone.ranking import rank_intervals, tie_groups

RANKED_BY = RATIOS.index("miou")
BLOCK, SEQUENCE = "block", "sequence"
READERS = 8
MOST_COLUMNS = 3000
MOST_OUTCOMES = 64

Floats = NDArray[np.float32]
Value = TypeVar("Value")


@dataclass(frozen=True)
class Surety:
    """Of each ranked entry the interval of its rank and its tie group; null where resampling tells nothing."""

    rank_intervals: tuple[tuple[int, int] | None, ...]
    tie_groups: tuple[int | None, ...]


class Kept(Generic[Value]):
    """The last `most` values by what they follow from; two threads that lack one at once both make it."""

    def __init__(self, most: int) -> None:
        self._most, self._lock = most, Lock()
        self._values: OrderedDict[Hashable, Value] = OrderedDict()

    def value(self, key: Hashable, make: Callable[[], Value]) -> Value:
        with self._lock:
            if key in self._values:
                self._values.move_to_end(key)
                return self._values[key]
        made = make()
        with self._lock:
            self._values[key] = made
            while len(self._values) > self._most:
                self._values.popitem(last=False)
        return made


_COLUMNS: Kept[Floats] = Kept(MOST_COLUMNS)
_OUTCOMES: Kept[Surety] = Kept(MOST_OUTCOMES)


def surety_of(store: Store, draws: Sequence[str], key_of: Mapping[str, str]) -> Surety:
    """Of entries in the order of the board, by the sha256 of their draws; `key_of` says where in the store each is."""
    return _OUTCOMES.value(tuple(draws), lambda: _weighed(columns(store, draws, key_of)))


def columns(store: Store, draws: Sequence[str], key_of: Mapping[str, str]) -> list[Floats]:
    """The block draws (D,) of the ranked ratio, of each entry."""

    def column(sha256: str) -> Floats:
        return _COLUMNS.value(
            sha256, lambda: np.ascontiguousarray(read_draws(store, key_of[sha256], BLOCK)[:, RANKED_BY])
        )

    with ThreadPoolExecutor(READERS) as readers:
        return list(readers.map(column, draws))


def read_draws(store: Store, object_key: str, kind: str) -> Floats:
    """Draws (D, 5) of a score; columns are `RATIOS`. Raises `StoreAwayError`."""
    return np.asarray(_member(b"".join(store.read(object_key)), kind), np.float32)


def _member(content: bytes, name: str) -> NDArray[Any]:
    with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
        return np.asarray(arrays[name])


def _weighed(found: list[Floats]) -> Surety:
    is_telling = len({column.shape for column in found}) == 1 and any(varies(column) for column in found)
    if not is_telling:
        return Surety((None,) * len(found), (None,) * len(found))
    draws = np.stack(found)
    intervals = tuple((low, high) for low, high in rank_intervals(draws).tolist())
    return Surety(intervals, tuple(tie_groups(draws).tolist()))


def varies(draws: Floats) -> bool:
    """Whether resampling changed anything."""
    return bool(len(draws)) and bool(np.any(draws != draws[0]))
