"""Rows of a damaged database, page by page: first those in its trees, then the leaves that no tree reaches.

**Conventions.** A row is kept once, if its whole payload can be assembled. A leaf without a parent counts only if every
row in it resembles a recorder's. The number of lost rows is that of missing rowids up to the last one present (a
recorder numbers them without gaps); losses after the last are unknown.
"""

import mmap
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stone.findings import Finding
from stone_recordings.bags.db3.collection import Db3CollectedRows, collect
from stone_recordings.bags.db3.pages import Db3Pages
from stone_recordings.bags.db3.records import layout_of
from stone_recordings.bags.db3.rows import RowIndex
from stone_recordings.bags.db3.sql import Db3Location
from stone_recordings.bags.errors import MalformedBagError, database_refused

DATA = 3


class SalvagedRows:
    """The readable rows of `place`, as `stone_recordings.bags.db3.rows`; `problem` is SQLite's message."""

    def __init__(self, place: Db3Location, name: str, problem: str) -> None:
        self._place, self._name = place, name
        self._pages = opened_pages(place, name)
        rows = collect(self._pages, name)
        if not rows.topics:
            raise database_refused(name, f"{problem}, and no topic can be found in its pages")
        self.topics = tuple(rows.topics[topic_id] for topic_id in sorted(rows.topics))
        self.definitions = rows.definitions
        table = _unique(rows)
        rowid, topic_id, time_ns, size_bytes = np.ascontiguousarray(table[:, :4].T)
        self._places = table[:, 4:]
        self.index = RowIndex(rowid, topic_id, time_ns, size_bytes, 0)
        self.findings: tuple[Finding, ...] = (_finding(name, problem, rowid),)

    def data(self, rowid: int) -> bytes:
        return self._read(rowid, None)

    def several(self, rowids: Sequence[int]) -> dict[int, bytes]:
        return {rowid: self.data(rowid) for rowid in rowids}

    def head(self, rowid: int, size_bytes: int) -> bytes:
        return self._read(rowid, size_bytes)

    def release(self) -> None:
        """Do nothing: unused pages of the map cost nothing."""

    def close(self) -> None:
        self._place.close()

    def _read(self, rowid: int, size_bytes: int | None) -> bytes:
        row = int(np.searchsorted(self.index.rowid, rowid))
        number, slot = (int(value) for value in self._places[row])
        cell = list(self._pages.cells(number))[slot]
        layout = layout_of(cell.local, cell.payload_bytes)
        if layout is None:
            raise MalformedBagError(self._name, f"row {rowid} changed while it was open")
        payload = self._pages.payload(cell, None if size_bytes is None else layout.at[DATA] + size_bytes)
        if payload is None:
            raise MalformedBagError(self._name, f"row {rowid} changed while it was open")
        return payload[layout.at[DATA] :]


def opened_pages(place: Db3Location, name: str) -> Db3Pages:
    """Return the pages of a database and of the log beside it, as memory maps."""
    return Db3Pages(_mapped(place.path), _mapped(place.wal), name)


def _mapped(path: Path | None) -> memoryview:
    if path is None or path.stat().st_size == 0:
        return memoryview(b"")
    with path.open("rb") as file:
        return memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))


def _unique(rows: Db3CollectedRows) -> NDArray[np.int64]:
    """Return one line per row, rowids ascending; the first of a duplicate rowid, which was reached through a tree."""
    table = np.array(rows.messages, np.int64).reshape(-1, 6)
    _rowids, first = np.unique(table[:, 0], return_index=True)
    return table[first]


def _finding(name: str, problem: str, rowid: NDArray[np.int64]) -> Finding:
    missing = int(rowid[-1]) - len(rowid) if len(rowid) else 0
    lost = f"at least {missing} more are lost" if missing > 0 else "whether more followed the last of them is unknown"
    message = f"{name} is damaged ({problem}): {len(rowid)} messages could be read from its pages, {lost}."
    return Finding("BAG-030", "error", name, message)
