"""Columns of tables with many rows: arrays of numbers instead of dictionaries.

**Conventions.** Tokens and names are stored as Python's hashes: 64 bits and different in every process, so that an
attacker cannot create collisions. The hash of "" is 0 and means no token.
"""

from array import array
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Keys = NDArray[np.int64]
NONE = 0


class NumberColumn:
    """A growing column of numbers; `code` is the type code of `array`."""

    def __init__(self, code: str) -> None:
        self._held: array[Any] = array(code)

    def add(self, *values: float) -> None:
        self._held.extend(values)

    def extend(self, values: Iterable[float]) -> None:
        """Append values. Raises `TypeError` for other types, `OverflowError` for numbers that are too large."""
        self._held.extend(values)

    def array(self, dtype: Any) -> NDArray[Any]:
        """Return all values, without a copy if the dtype matches; nothing may be appended afterwards."""
        return np.frombuffer(self._held, self._held.typecode).astype(dtype, copy=False)


class NameColumn:
    """Many strings, stored as bytes."""

    def __init__(self) -> None:
        self._bytes, self._ends = bytearray(), array("q", [0])

    def add(self, name: str) -> None:
        self._bytes += name.encode("utf-8", "surrogatepass")
        self._ends.append(len(self._bytes))

    def __len__(self) -> int:
        return len(self._ends) - 1

    def __getitem__(self, index: int) -> str:
        start, stop = self._ends[index], self._ends[index + 1]
        return self._bytes[start:stop].decode("utf-8", "surrogatepass")


def places_of(ascending: Keys, wanted: Keys) -> NDArray[np.int64]:
    """Return the position (N,) of each wanted key among ascending keys (the last of equal keys), or −1."""
    if not len(ascending):
        return np.full(len(wanted), -1, np.int64)
    at = np.searchsorted(ascending, wanted, "right") - 1
    return np.where((at >= 0) & (ascending[at] == wanted), at, -1)


def rows_of(keys: Keys, wanted: Keys) -> NDArray[np.int64]:
    """Return the index (N,) of each wanted key in the unsorted `keys`, or −1."""
    order = np.argsort(keys, kind="stable")
    at = places_of(keys[order], wanted)
    return np.where(at >= 0, order[at] if len(order) else at, -1)


def repeated(keys: Sequence[int] | Keys) -> list[tuple[int, int]]:
    """Return the index of each repeated key, with the index of its first occurrence."""
    held = np.asarray(keys, np.int64)
    order = np.argsort(held, kind="stable")
    is_first = np.append(True, np.diff(held[order]) != 0)[: len(held)]
    first = order[np.maximum.accumulate(np.where(is_first, np.arange(len(held)), 0))]
    again = np.flatnonzero(~is_first)
    return sorted(zip(order[again].tolist(), first[again].tolist(), strict=True))
