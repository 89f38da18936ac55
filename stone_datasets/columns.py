"""Columns of tables with many rows: numbers in arrays, not rows in dictionaries.

**Conventions.** Of tokens and names Python's hash is kept: 64 bits, another in every process, so that nobody can make
two that are equal. The hash of "" is 0, which therefore says that there is none.
"""

from array import array
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Keys = NDArray[np.int64]
NONE = 0


class NumberColumn:
    """Numbers of one kind, appended; `code` is that of `array`."""

    def __init__(self, code: str) -> None:
        self._held: array[Any] = array(code)

    def add(self, *values: float) -> None:
        self._held.extend(values)

    def extend(self, values: Iterable[float]) -> None:
        """Raises `TypeError` for what is no number, `OverflowError` for one that is too large."""
        self._held.extend(values)

    def array(self, dtype: Any) -> NDArray[Any]:
        """All of them, not copied where they are of that dtype: nothing may be added any more."""
        return np.frombuffer(self._held, self._held.typecode).astype(dtype, copy=False)


class NameColumn:
    """Many strings, held as their bytes."""

    def __init__(self) -> None:
        self._bytes, self._ends = bytearray(), array("q", [0])

    def add(self, name: str) -> None:
        self._bytes += name.encode("utf-8", "surrogatepass")
        self._ends.append(len(self._bytes))

    def __len__(self) -> int:
        return len(self._ends) - 1

    def __getitem__(self, place: int) -> str:
        start, stop = self._ends[place], self._ends[place + 1]
        return self._bytes[start:stop].decode("utf-8", "surrogatepass")


def places_of(ascending: Keys, wanted: Keys) -> NDArray[np.int64]:
    """Where each wanted key (N,) stands among the ascending ones, of equal ones the last; −1 where it does not."""
    if not len(ascending):
        return np.full(len(wanted), -1, np.int64)
    at = np.searchsorted(ascending, wanted, "right") - 1
    return np.where((at >= 0) & (ascending[at] == wanted), at, -1)


def rows_of(keys: Keys, wanted: Keys) -> NDArray[np.int64]:
    """The index of each wanted key (N,) among `keys`, which are in no order; −1 where it is none of them."""
    order = np.argsort(keys, kind="stable")
    at = places_of(keys[order], wanted)
    return np.where(at >= 0, order[at] if len(order) else at, -1)


def repeated(keys: Sequence[int] | Keys) -> list[tuple[int, int]]:
    """Index of each key that stands before, and the index where it first stood."""
    held = np.asarray(keys, np.int64)
    order = np.argsort(held, kind="stable")
    is_first = np.append(True, np.diff(held[order]) != 0)[: len(held)]
    first = order[np.maximum.accumulate(np.where(is_first, np.arange(len(held)), 0))]
    again = np.flatnonzero(~is_first)
    return sorted(zip(order[again].tolist(), first[again].tolist(), strict=True))
