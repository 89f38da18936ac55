"""Messages of one rosbag2 database (`.db3`), sound or damaged.

**Conventions.** SQLite opens the database in place and never writes to it. If SQLite reports it as malformed, the rows
in its pages are salvaged (finding BAG-030). Payloads are copies. Memory is the index, 32 bytes a message.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stone.findings import Finding
from stone_recordings.bags.db3.objects import DamagedSchemaError, tables_of
from stone_recordings.bags.db3.rows import Db3Rows, Db3Topic
from stone_recordings.bags.db3.salvage import SalvagedRows, opened_pages
from stone_recordings.bags.db3.sql import DamagedDatabaseError, Db3Location, SqlRows, db3_location_of
from stone_recordings.bags.errors import MalformedBagError, encoding_refused
from stone_recordings.bags.message_store import HEAD_BYTES, NO_MESSAGES, Messages, Topic

# The number of small messages per read, while they are read in order.
AHEAD_ROWS = 256


class SqliteStore:
    """One open database; `is_indexed` is True because its rows are."""

    is_indexed = True

    def __init__(self, path: Path) -> None:
        self._name = path.name
        self._ahead: dict[int, bytes] = {}
        self._next = ("", 0)
        location = db3_location_of(path)
        try:
            self._rows: Db3Rows = _rows_of(location, path.name)
            self._order = _by_topic(self._rows, path.name)
        except BaseException:
            location.close()
            raise
        self.topics = tuple(self._topic(name) for name in sorted(self._order))
        self.findings: tuple[Finding, ...] = (*location.findings, *self._rows.findings, *self._left_out())
        if self.topics and all(topic.encoding != "cdr" for topic in self.topics):
            self.close()
            raise encoding_refused(path.name, self.topics[0].name, self.topics[0].encoding)

    def log_times_ns(self, topic: str) -> NDArray[np.int64]:
        return self._rows.index.time_ns[self._order[topic]]

    def payload(self, topic: str, index: int) -> memoryview:
        rows, is_in_order = self._order[topic], self._next == (topic, index)
        self._next = (topic, index + 1)
        data = self._ahead.pop(int(rows[index]), None)
        upcoming = rows[index : index + AHEAD_ROWS if is_in_order else index + 1]
        return memoryview(self._read(upcoming, is_whole=True) if data is None else data)

    def heads(
        self, topics: Sequence[str], whole: Collection[str] = (), *, is_checked: bool = False
    ) -> Iterator[tuple[str, int, memoryview]]:
        """Yield by rowid, which is the order in the file."""
        if not topics:
            return
        rows = np.concatenate([self._order[topic] for topic in topics])
        numbers = np.concatenate([np.full(len(self._order[topic]), n) for n, topic in enumerate(topics)])
        indices = np.concatenate([np.arange(len(self._order[topic])) for topic in topics])
        order = np.argsort(rows, kind="stable")
        rows = rows[order]
        stored = zip(rows.tolist(), numbers[order].tolist(), indices[order].tolist(), strict=True)
        for position, (row, number, index) in enumerate(stored):
            head = self._ahead.pop(row, None)
            if head is None:
                head = self._read(rows[position : position + AHEAD_ROWS], is_whole=topics[number] in whole)
            yield topics[number], index, memoryview(head)

    def size_bytes(self, topic: str, index: int) -> int:
        return int(self._rows.index.size_bytes[self._order[topic][index]])

    def damaged(self, beside: Messages = NO_MESSAGES) -> Mapping[str, Mapping[int, str]]:
        """Return none: rows carry no checksum, and those of a damaged page were left out on opening."""
        return {}

    def read_sparingly(self) -> None:
        """Do nothing: rows are read page by page."""

    def release(self) -> None:
        self._ahead = {}
        self._rows.release()

    def close(self) -> None:
        self._rows.close()

    def _read(self, upcoming: NDArray[np.int64], *, is_whole: bool) -> bytes:
        """Return the message of the first of the next rows; small messages are read many at a time."""
        index = self._rows.index
        rowid, size_bytes = int(index.rowid[upcoming[0]]), int(index.size_bytes[upcoming[0]])
        try:
            if size_bytes <= HEAD_BYTES and len(upcoming) > 1:
                self._read_ahead(upcoming)
                if (data := self._ahead.pop(int(upcoming[0]), None)) is not None:
                    return data
            return (
                self._rows.data(rowid) if is_whole or size_bytes <= HEAD_BYTES else self._rows.head(rowid, HEAD_BYTES)
            )
        except DamagedDatabaseError as error:
            raise MalformedBagError(f"{self._name}, message row {rowid}", str(error)) from None

    def _read_ahead(self, upcoming: NDArray[np.int64]) -> None:
        index = self._rows.index
        small = upcoming[index.size_bytes[upcoming] <= HEAD_BYTES]
        rowids = index.rowid[small].tolist()
        with suppress(DamagedDatabaseError):  # then each is read alone, and the damaged one raises
            messages = self._rows.several(rowids)
            self._ahead = {
                row: messages[rowid] for row, rowid in zip(small.tolist(), rowids, strict=True) if rowid in messages
            }

    def _topic(self, name: str) -> Topic:
        declared = next(topic for topic in self._rows.topics if topic.name == name)
        schema = self._rows.definitions.get(declared.type, "")
        return Topic(name, declared.type, len(self._order[name]), schema, declared.encoding)

    def _left_out(self) -> Iterator[Finding]:
        known = sum(len(rows) for rows in self._order.values())
        count = self._rows.index.left_out + len(self._rows.index.rowid) - known
        if count:
            message = f"{count} rows of {self._name} are not messages (other columns, or a topic that is not listed)."
            yield Finding("BAG-031", "warning", self._name, message)


def _rows_of(location: Db3Location, name: str) -> Db3Rows:
    """Return the rows; SQLite is used only if the schema is a recorder's and SQLite reports no damage."""
    if location.path.stat().st_size == 0:  # SQLite would delete the log of an empty file instead of reading it
        return SalvagedRows(location, name, "its file is empty, all data is in its write-ahead log")
    try:
        tables_of(opened_pages(location, name), name)
        return SqlRows(location, name)
    except DamagedSchemaError:
        return SalvagedRows(location, name, "its schema cannot be read")
    except DamagedDatabaseError as error:
        return SalvagedRows(location, name, str(error)[:160])


def _by_topic(rows: Db3Rows, name: str) -> dict[str, NDArray[np.int64]]:
    """Return rows of each topic in log-time order, ties in file order; several ids may carry one topic, of one type."""
    types: dict[str, Db3Topic] = {}
    for topic in rows.topics:
        first = types.setdefault(topic.name, topic)
        if (first.type, first.encoding) != (topic.type, topic.encoding):
            raise MalformedBagError(name, f"topic {topic.name!r} is recorded as {first.type} and as {topic.type}")
    names = sorted(types)
    number_of = {topic_name: number for number, topic_name in enumerate(names)}
    ids = np.array(sorted(topic.topic_id for topic in rows.topics), np.int64)
    name_of_id = {topic.topic_id: number_of[topic.name] for topic in rows.topics}
    numbers = np.array([name_of_id[topic_id] for topic_id in ids.tolist()], np.int64)
    row = np.searchsorted(ids, rows.index.topic_id)
    known = np.flatnonzero(np.append(ids, 0)[row] == rows.index.topic_id if len(ids) else np.zeros(0, np.bool_))
    number = numbers[row[known]]
    order = known[np.lexsort((known, rows.index.time_ns[known], number))]
    stops = np.cumsum(np.bincount(number, minlength=len(names)))
    return dict(zip(names, np.split(order, stops[:-1]), strict=True)) if names else {}
