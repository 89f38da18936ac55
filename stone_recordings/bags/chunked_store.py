"""The common part of message stores over mapped files of chunks: only compressed data is copied.

**Conventions.** The file must not change while it is open (cutting a mapped file raises SIGBUS). Payloads are views
into the map or into an inflated chunk, or built from them, and keep it alive; `close` drops our reference. Memory is
the index (20 bytes a message) and the `KEPT_CHUNKS` chunks used last, because neighbours in time may lie in two. A pass
that checks chunks also holds the next `AHEAD_CHUNKS`, of at most `AHEAD_BYTES` each, which a thread inflates meanwhile.
"""

import mmap
from abc import ABC, abstractmethod
from collections import OrderedDict
from collections.abc import Collection, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stone.findings import Finding
from stone_recordings.bags.chunks import Chunk, check_crc32, inflate, inflate_head
from stone_recordings.bags.errors import ChecksumError, MalformedBagError
from stone_recordings.bags.message_places import Entries, in_storage_order, reach_of
from stone_recordings.bags.message_store import NO_MESSAGES, Messages

KEPT_CHUNKS = 2
AHEAD_CHUNKS = 2  # with one, the thread starts it only when the pass waits for it (GIL)
AHEAD_BYTES = 32 * 2**20
# Beyond this share of a chunk, inflating it whole, at once and checked, costs no more than its head piece by piece.
MOST_HEAD_RATIO = 0.5
FORGET_BYTES = 64 * 2**20  # the bytes to read on before releasing pages, which may still be in use


class MappedFile:
    """A file in memory by its pages; `view` is the part of it that counts."""

    def __init__(self, path: Path) -> None:
        with path.open("rb") as file:
            self.map = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        self.name, self.view = path.name, memoryview(self.map)
        self.is_read_ahead = True

    def read_ahead(self, is_wanted: bool) -> None:
        """Set whether the kernel may read ahead, up to megabytes; with an index this is not needed."""
        self.is_read_ahead = is_wanted
        self.map.madvise(mmap.MADV_NORMAL if is_wanted else mmap.MADV_RANDOM)

    def forget(self, start: int, stop: int) -> None:
        """Release the pages of these bytes: reading them again costs a page fault, keeping them counts as our
        memory.
        """
        first = start - start % mmap.PAGESIZE
        self.map.madvise(mmap.MADV_DONTNEED, first, stop - first)

    def forget_all(self) -> None:
        self.forget(0, len(self.map))

    def expect(self, start: int, size_bytes: int) -> None:
        """Request this number of bytes in one read."""
        first = start - start % mmap.PAGESIZE
        self.map.madvise(mmap.MADV_WILLNEED, first, size_bytes)


@dataclass(frozen=True, eq=False)
class PlacedMessages:
    """The chunks of a file, and by topic the places of its messages, in log-time order."""

    chunks: Sequence[Chunk]
    entries: Mapping[str, Entries]


class ChunkedStore(ABC):
    """The part of a `MessageStore` that handles chunks, independent of the record format.

    `head_bytes` is the end of a message's head in its record.
    """

    head_bytes: int

    def __init__(self, file: MappedFile, placed: PlacedMessages) -> None:
        self._file, self._placed, self._entries = file, placed, placed.entries
        file.forget_all()  # the indexes are spread over the file, and each one loaded its neighbours
        self._chunks: OrderedDict[int, memoryview] = OrderedDict()
        self._checked: set[int] = set()
        self._damaged: dict[int, str] = {}
        self._sound: set[int] = set()
        self._head = (-1, memoryview(b""))
        self._coming: dict[int, Future[memoryview]] = {}
        self._near_byte = self._dropped_bytes = 0
        self._is_sparing = False

    @abstractmethod
    def _found(self, view: memoryview, topic: str, index: int) -> memoryview:
        """Return the CDR message in `view`, the records of its chunk, which may end after the message's head.

        Raises: MalformedBagError if the record differs from the index.
        """

    def log_times_ns(self, topic: str) -> NDArray[np.int64]:
        return self._entries[topic].log_time_ns

    def payload(self, topic: str, index: int) -> memoryview:
        """Return the message's CDR bytes, after checking the chunk's CRC-32 if there is one."""
        number, offset = self._place(topic, index)
        if number < 0 and abs(offset - self._near_byte) > FORGET_BYTES:
            self._file.forget_all()
            self._near_byte = offset
        if number < 0 or self._file.is_read_ahead or self._placed.chunks[number].compression:
            return self._found(self._records(number, is_checked=True), topic, index)
        payload = self._found(self._records(number, is_checked=not self._is_sparing), topic, index)
        self._file.expect(self._placed.chunks[number].start + offset, len(payload))
        if self._is_sparing and len(payload) > MOST_HEAD_RATIO * self._size_of(number):
            self._records(number, is_checked=True)
        return payload

    def heads(
        self, topics: Sequence[str], whole: Collection[str] = (), *, is_checked: bool = False
    ) -> Iterator[tuple[str, int, memoryview]]:
        """Yield heads in storage order, so that each chunk is inflated once, and only as far as heads lie in it.

        Plain chunks are not read whole. A payload is cut short only if its chunk was not inflated to its end. If chunks
        are checked, they are read and inflated whole, each while the previous ones are in use.
        """
        rows = in_storage_order([self._entries[topic] for topic in topics])
        reach = reach_of(rows, np.array([topic in whole for topic in topics]), self.head_bytes)
        coming = iter(dict.fromkeys(rows.chunk.tolist() if is_checked else ()))
        # If the kernel read ahead at every header, a scan of a cold file would take 85 times as long.
        is_read_ahead = self._file.is_read_ahead
        self._file.read_ahead(False)
        try:
            with ThreadPoolExecutor(1) as beside:
                for number, index, chunk in zip(
                    rows.topic.tolist(), rows.index.tolist(), rows.chunk.tolist(), strict=True
                ):
                    if is_checked:
                        self._inflate_ahead(coming, beside)
                        self._check(chunk)
                    if chunk not in self._damaged:
                        view = self._head_of(chunk, reach[chunk])
                        is_whole = topics[number] in whole
                        yield topics[number], index, self._head_found(view, topics[number], index, is_whole)
        finally:
            self._file.read_ahead(is_read_ahead)
            self._head = (-1, memoryview(b""))
            self._coming.clear()

    def damaged(self, beside: Messages = NO_MESSAGES) -> Mapping[str, Mapping[int, str]]:
        """Return the messages of chunks whose CRC-32 differs from the declared one, or which do not inflate."""
        none = np.zeros(0, np.int64)
        used = np.unique(np.concatenate([none, *(entries.chunk for entries in self._entries.values())]))
        passed = np.concatenate([none, *(self._entries[topic].chunk[rows] for topic, rows in beside.items())])
        used = np.setdiff1d(used[used >= 0], passed)
        for number in (number for number in used.tolist() if number not in self._sound):
            self._check(number)
            self._file.forget(self._placed.chunks[number].start, self._placed.chunks[number].stop)
        bad = np.array(sorted(self._damaged), np.int64)
        return {
            topic: {
                row: self._damaged[int(entries.chunk[row])]
                for row in np.flatnonzero(np.isin(entries.chunk, bad)).tolist()
            }
            for topic, entries in self._entries.items()
            if np.isin(entries.chunk, bad).any()
        }

    def _check(self, number: int) -> None:
        """Record whether a chunk is damaged; each chunk is checked once."""
        if number < 0 or number in self._sound or number in self._damaged:
            return
        chunk = self._placed.chunks[number]
        self._file.expect(chunk.start, chunk.stop - chunk.start)
        try:
            self._records(number, is_checked=True)
        except (ChecksumError, MalformedBagError) as error:
            self._damaged[number] = str(error)
            return
        self._sound.add(number)

    def _inflate_ahead(self, coming: Iterator[int], beside: Executor) -> None:
        """Start a thread that inflates the next chunks to be checked."""
        while len(self._coming) < AHEAD_CHUNKS and (number := next(coming, None)) is not None:
            if number < 0 or number in self._sound or number in self._damaged or number in self._chunks:
                continue
            chunk = self._placed.chunks[number]
            if chunk.compression and chunk.uncompressed_bytes <= AHEAD_BYTES:
                self._file.expect(chunk.start, chunk.stop - chunk.start)
                self._coming[number] = beside.submit(inflate, self._file.view, chunk)

    def read_sparingly(self) -> None:
        self._is_sparing = True

    def release(self) -> None:
        self._chunks.clear()

    def close(self) -> None:
        self._chunks.clear()
        self._file.view = memoryview(b"")

    def _head_found(self, view: memoryview, topic: str, index: int, is_whole: bool) -> memoryview:
        """Return `_found` for a scan of heads; a store may convert less if the message is not wanted whole."""
        return self._found(view, topic, index)

    def _place(self, topic: str, index: int) -> tuple[int, int]:
        """Return the chunk, and the offset in it."""
        entries = self._entries[topic]
        return int(entries.chunk[index]), int(entries.offset[index])

    def _size_of(self, number: int) -> int:
        """Return the number of bytes of records in a chunk."""
        return len(self._file.view) if number < 0 else self._placed.chunks[number].uncompressed_bytes

    def _where(self, number: int) -> str:
        return self._file.name if number < 0 else self._placed.chunks[number].where

    def _seen_head(self, number: int) -> memoryview:
        """Return the last inflated bytes of `heads` if they are of this chunk, else its records."""
        is_head = number >= 0 and number == self._head[0]
        return self._head[1] if is_head else self._records(number, is_checked=False)

    def _records(self, number: int, is_checked: bool) -> memoryview:
        if number < 0:
            return self._file.view
        chunk = self._placed.chunks[number]
        if chunk.crc32 and not chunk.compression and is_checked and number not in self._checked:
            self._expect(chunk)
            check_crc32(self._file.view[chunk.start : chunk.stop], chunk)
            self._checked.add(number)
        if number in self._chunks:
            self._chunks.move_to_end(number)
            return self._chunks[number]
        while len(self._chunks) >= KEPT_CHUNKS:
            self._drop_oldest()
        coming = self._coming.pop(number, None)
        if coming is None and chunk.compression:
            self._expect(chunk)
        self._chunks[number] = inflate(self._file.view, chunk) if coming is None else coming.result()
        return self._chunks[number]

    def _expect(self, chunk: Chunk) -> None:
        """Request a chunk in one read if the kernel does not read ahead."""
        if not self._file.is_read_ahead:
            self._file.expect(chunk.start, chunk.stop - chunk.start)

    def _head_of(self, number: int, reach: int) -> memoryview:
        """Return the records up to `reach`, or all of them if that is most of them; they are read at once."""
        if number < 0 or not (chunk := self._placed.chunks[number]).compression or number in self._chunks:
            return self._records(number, is_checked=False)
        if self._head[0] == number:
            return self._head[1]
        is_short = reach < chunk.uncompressed_bytes * MOST_HEAD_RATIO
        packed_bytes = chunk.stop - chunk.start
        self._file.expect(chunk.start, min(packed_bytes, reach) if is_short else packed_bytes)
        if not is_short:
            return self._records(number, is_checked=False)
        self._head = (number, inflate_head(self._file.view, chunk, reach))
        self._file.forget(chunk.start, chunk.stop)
        return self._head[1]

    def _drop_oldest(self) -> None:
        """Drop the oldest chunk, now and then with the pages before it: gathered messages are used after their chunk is
        dropped.
        """
        dropped = self._placed.chunks[self._chunks.popitem(last=False)[0]]
        self._dropped_bytes += dropped.stop - dropped.start
        is_far = self._dropped_bytes > FORGET_BYTES // 2
        self._file.forget(max(0, dropped.start - FORGET_BYTES) if is_far else dropped.start, dropped.stop)
        self._dropped_bytes = 0 if is_far else self._dropped_bytes


def behind_end(count: int, *, is_zero: bool) -> Finding:
    """Return the finding about bytes after the end of a whole file."""
    kind = "zero bytes" if is_zero else "bytes that are not records"
    message = f"{count} {kind} follow the end of the file; they are skipped, and the file itself is complete."
    return Finding("BAG-032", "info" if is_zero else "warning", "", message)
