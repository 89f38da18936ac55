"""Places of the messages in a file of chunks, by topic, and their reading order.

**Conventions.** A place is (log time, chunk number, offset of the message record in that chunk's records); chunk −1 is
the file itself, for messages outside of chunks.
"""

from array import array
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Entries:
    """The messages of one channel in file order."""

    log_time_ns: NDArray[np.int64]
    chunk: NDArray[np.int32]
    offset: NDArray[np.int64]


@dataclass(frozen=True)
class GrowingEntries:
    """Entries while the file is read, in compact arrays: a recording may hold millions of messages."""

    log_time_ns: "array[int]" = field(default_factory=lambda: array("q"))
    chunk: "array[int]" = field(default_factory=lambda: array("i"))
    offset: "array[int]" = field(default_factory=lambda: array("q"))

    def add(self, log_time_ns: int, chunk: int, offset: int) -> None:
        self.log_time_ns.append(log_time_ns)
        self.chunk.append(chunk)
        self.offset.append(offset)

    def extend(self, log_time_ns: NDArray[np.int64], chunk: int, offset: NDArray[np.int64]) -> None:
        """Add the messages of one chunk."""
        self.log_time_ns.frombytes(log_time_ns.tobytes())
        self.chunk.extend([chunk] * len(offset))
        self.offset.frombytes(offset.tobytes())

    def join(self, others: "GrowingEntries") -> None:
        """Append the entries of another."""
        self.log_time_ns.extend(others.log_time_ns)
        self.chunk.extend(others.chunk)
        self.offset.extend(others.offset)

    def finished(self) -> Entries:
        return Entries(
            np.array(self.log_time_ns, np.int64), np.array(self.chunk, np.int32), np.array(self.offset, np.int64)
        )


@dataclass(frozen=True, eq=False)
class StorageOrder:
    """For N messages: number of the topic, index in it, chunk, and offset in the chunk, in storage order."""

    topic: NDArray[np.int64]
    index: NDArray[np.int64]
    chunk: NDArray[np.int64]
    offset: NDArray[np.int64]


def in_log_order(parts: Sequence[Entries]) -> Entries:
    """Return the messages of several channels of one topic by log time (ties: file order)."""
    times = np.concatenate([part.log_time_ns for part in parts])
    chunks = np.concatenate([part.chunk for part in parts])
    offsets = np.concatenate([part.offset for part in parts])
    order = np.lexsort((offsets, chunks, times))
    return Entries(times[order], chunks[order], offsets[order])


def in_storage_order(parts: Sequence[Entries]) -> StorageOrder:
    """Return all messages of these topics in storage order."""
    none = np.zeros(0, np.int64)
    topic = np.concatenate([none, *(np.full(len(part.offset), number) for number, part in enumerate(parts))])
    index = np.concatenate([none, *(np.arange(len(part.offset)) for part in parts)])
    chunk = np.concatenate([none, *(part.chunk for part in parts)])
    offset = np.concatenate([none, *(part.offset for part in parts)])
    order = np.lexsort((offset, chunk))
    return StorageOrder(topic[order], index[order], chunk[order], offset[order])


def reach_of(rows: StorageOrder, is_whole: NDArray[np.bool_], head_bytes: int) -> dict[int, int]:
    """Return by chunk the last byte that heads, and messages wanted whole, can reach; the chunk's end is unknown here.

    A head, with that of its record, takes `head_bytes`. A whole message ends at the next one's start at the latest; the
    last message of a chunk may take all of it.
    """
    if not len(rows.chunk):
        return {}
    ends = rows.offset + head_bytes
    is_last = np.append(rows.chunk[1:] != rows.chunk[:-1], True)
    whole = is_whole[rows.topic]
    ends[whole & is_last] = np.iinfo(np.int64).max
    following = np.append(rows.offset[1:], 0)
    ends[whole & ~is_last] = following[whole & ~is_last]
    first = np.flatnonzero(np.append(True, is_last[:-1]))
    return dict(zip(rows.chunk[first].tolist(), np.maximum.reduceat(ends, first).tolist(), strict=True))
