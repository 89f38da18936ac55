"""Messages of a sealed MCAP file through a memory map: nothing is copied that is not compressed.

**Conventions.** The file must not change while it is open (a mapped file that is cut raises SIGBUS). Payloads are
views into the map or into an inflated chunk and keep it alive; `close` lets go of ours, the last view of theirs. Memory
is the index (20 bytes a message) and the `KEPT_CHUNKS` chunks used last: neighbours in time may lie in two.
"""

import mmap
from collections import OrderedDict
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from struct import Struct

import numpy as np
from numpy.typing import NDArray

from stone.findings import Finding
from stone_recordings.bags.errors import ChecksumError, EncodingRefusedError, MalformedBagError
from stone_recordings.bags.mcap import records as wire
from stone_recordings.bags.mcap.catalogue import Catalogue, Entries, message_head, read_catalogue
from stone_recordings.bags.mcap.chunks import check_crc32, inflate, inflate_head
from stone_recordings.bags.mcap.sealed_end import sealed_bytes
from stone_recordings.bags.message_store import HEAD_BYTES
from stone_recordings.bags.topic import Topic

KEPT_CHUNKS = 2
_MESSAGE = Struct("<BQHIQQ")  # a record's opcode and length, then a message's head
# Beyond this share of a chunk inflating it whole, at once and checked, costs no more than its head piece by piece.
MOST_HEAD_RATIO = 0.5
FORGET_BYTES = 64 * 2**20  # how far to read on before giving back pages that may have been looked at late


@dataclass(frozen=True, eq=False)
class _Rows:
    """Of N messages: number of the topic, index in it, chunk, and offset in that."""

    topic: NDArray[np.int64]
    index: NDArray[np.int64]
    chunk: NDArray[np.int64]
    offset: NDArray[np.int64]


class McapStore:
    """One open MCAP file; `is_indexed` is False where the whole file had to be walked."""

    def __init__(self, path: Path) -> None:
        with path.open("rb") as file:
            self._map = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
            sealed = sealed_bytes(file)
        self._name = path.name
        self._view = memoryview(self._map)[:sealed]
        self.findings = (*_damaged_start(self._view, path.name), *_zeros_behind(len(self._map) - len(self._view)))
        self._catalogue = read_catalogue(self._view, self._name)
        self._forget(0, len(self._map))  # the indexes lie all over the file, and each brought its neighbours
        self._chunks: OrderedDict[int, memoryview] = OrderedDict()
        self._checked: set[int] = set()
        self._damaged: dict[int, str] = {}
        self._head = (-1, memoryview(b""))
        self._near_byte = self._dropped_bytes = 0
        self._entries = _merged_by_topic(self._catalogue, self._name)
        self._topic_of = {number: channel.topic for number, channel in self._catalogue.channels.items()}
        self.topics = _topics(self._catalogue, self._entries)
        self.is_indexed = self._catalogue.is_indexed
        self._refuse_other_encodings()

    def log_times_ns(self, topic: str) -> NDArray[np.int64]:
        return self._entries[topic].log_time_ns

    def payload(self, topic: str, index: int) -> memoryview:
        """The message's CDR bytes, the chunk's CRC-32 checked where one was written."""
        return self._payload(topic, index, is_checked=True)

    def heads(self, topics: Sequence[str], whole: Collection[str] = ()) -> Iterator[tuple[str, int, memoryview]]:
        """Storage order, so that each chunk is inflated once, and no further than heads lie in it.

        Plain chunks are not read whole for it. A payload is cut short only where its chunk was not inflated to its end.
        """
        rows = _rows_of([self._entries[topic] for topic in topics])
        reach = _reach_of(rows, np.array([topic in whole for topic in topics]))
        # Without it the kernel reads ahead around every header: a scan of a cold file takes 85 times as long.
        self._map.madvise(mmap.MADV_RANDOM)
        try:
            for number, index, chunk in zip(rows.topic.tolist(), rows.index.tolist(), rows.chunk.tolist(), strict=True):
                if chunk in self._damaged:
                    continue
                view = self._head_of(chunk, reach[chunk]) if chunk >= 0 else None
                yield topics[number], index, self._payload(topics[number], index, is_checked=False, head=view)
        finally:
            self._map.madvise(mmap.MADV_NORMAL)
            self._head = (-1, memoryview(b""))

    def size_bytes(self, topic: str, index: int) -> int:
        """By the record's own length: what `heads` inflated last tells it without more."""
        number, offset = int(self._entries[topic].chunk[index]), int(self._entries[topic].offset[index])
        is_head = number >= 0 and number == self._head[0]
        view = self._head[1] if is_head else self._view if number < 0 else self._records(number, is_checked=False)
        return int(_MESSAGE.unpack_from(view, offset)[1]) - (_MESSAGE.size - wire.PREFIX_BYTES)

    def damaged(self) -> Mapping[str, Mapping[int, str]]:
        """The messages of chunks whose CRC-32 is another than declared, or which do not inflate."""
        used = np.unique(np.concatenate([np.zeros(0, np.int64), *(one.chunk for one in self._entries.values())]))
        for number in used[used >= 0].tolist():
            try:
                self._records(number, is_checked=True)
            except (ChecksumError, MalformedBagError) as error:
                self._damaged[number] = str(error)
            self._forget(self._catalogue.chunks[number].start, self._catalogue.chunks[number].stop)
        bad = np.array(sorted(self._damaged), np.int64)
        return {
            topic: {row: self._damaged[int(one.chunk[row])] for row in np.flatnonzero(np.isin(one.chunk, bad)).tolist()}
            for topic, one in self._entries.items()
            if np.isin(one.chunk, bad).any()
        }

    def release(self) -> None:
        self._chunks.clear()

    def close(self) -> None:
        self._chunks.clear()
        self._view = memoryview(b"")

    def _payload(self, topic: str, index: int, *, is_checked: bool, head: memoryview | None = None) -> memoryview:
        """`head` is what is inflated of its chunk, when that is not to be touched whole."""
        entries = self._entries[topic]
        number, offset = int(entries.chunk[index]), int(entries.offset[index])
        if number < 0 and abs(offset - self._near_byte) > FORGET_BYTES:
            self._forget(0, len(self._map))
            self._near_byte = offset
        view = head if head is not None else self._view if number < 0 else self._records(number, is_checked)
        size = len(self._view) if number < 0 else self._catalogue.chunks[number].uncompressed_bytes
        if 0 <= offset <= len(view) - _MESSAGE.size:
            opcode, length, channel_id, _sequence, log_time_ns, _published_ns = _MESSAGE.unpack_from(view, offset)
            start, stop = offset + _MESSAGE.size, offset + wire.PREFIX_BYTES + length
            is_promised = self._topic_of.get(channel_id) == topic and log_time_ns == entries.log_time_ns[index]
            if opcode == wire.MESSAGE and start <= stop <= size and is_promised:
                return view[start:stop]
        raise self._broken_promise(self._records(number, is_checked) if number >= 0 else view, number, offset)

    def _broken_promise(self, view: memoryview, number: int, offset: int) -> MalformedBagError:
        """What stands where the index promised a message."""
        where = self._name if number < 0 else self._catalogue.chunks[number].where
        try:
            record = wire.record_at(view, offset, len(view), where)
            if record.opcode != wire.MESSAGE:
                return MalformedBagError(where, f"the index points at byte {offset}, where no message starts")
            message_head(view, record, where)
        except MalformedBagError as error:
            return error
        return MalformedBagError(where, f"the message at byte {offset} is not the one that the index promised")

    def _records(self, number: int, is_checked: bool) -> memoryview:
        chunk = self._catalogue.chunks[number]
        if not chunk.compression and is_checked and number not in self._checked:
            check_crc32(self._view[chunk.start : chunk.stop], chunk)
            self._checked.add(number)
        if number in self._chunks:
            self._chunks.move_to_end(number)
            return self._chunks[number]
        while len(self._chunks) >= KEPT_CHUNKS:
            self._drop_oldest()
        self._chunks[number] = inflate(self._view, chunk)
        return self._chunks[number]

    def _head_of(self, number: int, reach: int) -> memoryview:
        """The records up to `reach`, or all of them where that is most of them; they are read in one go."""
        chunk = self._catalogue.chunks[number]
        if not chunk.compression or number in self._chunks:
            return self._records(number, is_checked=False)
        if self._head[0] == number:
            return self._head[1]
        is_short = reach < chunk.uncompressed_bytes * MOST_HEAD_RATIO
        first = chunk.start - chunk.start % mmap.PAGESIZE
        self._map.madvise(mmap.MADV_WILLNEED, first, min(chunk.stop - first, reach if is_short else chunk.stop - first))
        if not is_short:
            return self._records(number, is_checked=False)
        self._head = (number, inflate_head(self._view, chunk, reach))
        self._forget(chunk.start, chunk.stop)
        return self._head[1]

    def _drop_oldest(self) -> None:
        """Now and then with what lies before it: whoever gathers messages looks at them after their chunk has gone."""
        dropped = self._catalogue.chunks[self._chunks.popitem(last=False)[0]]
        self._dropped_bytes += dropped.stop - dropped.start
        is_far = self._dropped_bytes > FORGET_BYTES // 2
        self._forget(max(0, dropped.start - FORGET_BYTES) if is_far else dropped.start, dropped.stop)
        self._dropped_bytes = 0 if is_far else self._dropped_bytes

    def _forget(self, start: int, stop: int) -> None:
        """Give the pages of these bytes back: read again they cost a page fault, kept they count as our memory."""
        first = start - start % mmap.PAGESIZE
        self._map.madvise(mmap.MADV_DONTNEED, first, stop - first)

    def _refuse_other_encodings(self) -> None:
        recorded = [channel for channel in self._catalogue.channels.values() if channel.topic in self._entries]
        other = [channel for channel in recorded if channel.encoding != "cdr"]
        if other and len(other) == len(recorded):
            raise EncodingRefusedError(self._name, other[0].topic, other[0].encoding)


def _damaged_start(view: memoryview, name: str) -> tuple[Finding, ...]:
    if view[: len(wire.MAGIC)] == wire.MAGIC:
        return ()
    message = (
        "Its first bytes are not those of an MCAP file, its last are: its beginning is damaged. What the summary at "
        f"its end knows is read; for other programs: stone recover {name} -o recovered.mcap."
    )
    return (Finding("BAG-033", "warning", "", message),)


def _zeros_behind(count: int) -> tuple[Finding, ...]:
    if not count:
        return ()
    message = f"{count} zero bytes follow the end of the file; they are passed over, and nothing of it is missing."
    return (Finding("BAG-032", "info", "", message),)


def _rows_of(parts: Sequence[Entries]) -> _Rows:
    """All messages of these topics in the order in which they are stored."""
    none = np.zeros(0, np.int64)
    topic = np.concatenate([none, *(np.full(len(part.offset), number) for number, part in enumerate(parts))])
    index = np.concatenate([none, *(np.arange(len(part.offset)) for part in parts)])
    chunk = np.concatenate([none, *(part.chunk for part in parts)])
    offset = np.concatenate([none, *(part.offset for part in parts)])
    order = np.lexsort((offset, chunk))
    return _Rows(topic[order], index[order], chunk[order], offset[order])


def _reach_of(rows: _Rows, is_whole: NDArray[np.bool_]) -> dict[int, int]:
    """By chunk: up to which of its bytes heads, and messages that are wanted whole, can lie; the end is not known here.

    A whole message ends where the next one begins at the latest; the last of a chunk may take all of it.
    """
    if not len(rows.chunk):
        return {}
    ends = rows.offset + _MESSAGE.size + HEAD_BYTES
    is_last = np.append(rows.chunk[1:] != rows.chunk[:-1], True)
    whole = is_whole[rows.topic]
    ends[whole & is_last] = np.iinfo(np.int64).max
    following = np.append(rows.offset[1:], 0)
    ends[whole & ~is_last] = following[whole & ~is_last]
    first = np.flatnonzero(np.append(True, is_last[:-1]))
    return dict(zip(rows.chunk[first].tolist(), np.maximum.reduceat(ends, first).tolist(), strict=True))


def _merged_by_topic(catalogue: Catalogue, name: str) -> dict[str, Entries]:
    """Entries in log-time order (ties: file order); several channels may carry one topic, of one type."""
    parts: dict[str, list[Entries]] = {}
    meaning: dict[str, tuple[str, str]] = {}
    for channel_id, channel in sorted(catalogue.channels.items()):
        said = (_type_of(catalogue, channel_id), channel.encoding)
        if meaning.setdefault(channel.topic, said) != said:
            raise MalformedBagError(
                name, f"topic {channel.topic!r} is recorded both as {meaning[channel.topic]} and {said}"
            )
        empty = Entries(np.empty(0, np.int64), np.empty(0, np.int32), np.empty(0, np.int64))
        parts.setdefault(channel.topic, []).append(catalogue.entries.get(channel_id, empty))
    return {topic: _sorted(listed) for topic, listed in parts.items()}


def _sorted(parts: list[Entries]) -> Entries:
    times = np.concatenate([part.log_time_ns for part in parts])
    chunks = np.concatenate([part.chunk for part in parts])
    offsets = np.concatenate([part.offset for part in parts])
    order = np.lexsort((offsets, chunks, times))
    return Entries(times[order], chunks[order], offsets[order])


def _type_of(catalogue: Catalogue, channel_id: int) -> str:
    schema = catalogue.schemas.get(catalogue.channels[channel_id].schema_id)
    return schema.name if schema else ""


def _topics(catalogue: Catalogue, entries: dict[str, Entries]) -> tuple[Topic, ...]:
    topics = {}
    for channel in catalogue.channels.values():
        schema = catalogue.schemas.get(channel.schema_id)
        name, text = (schema.name, schema.text) if schema else ("", "")
        topics[channel.topic] = Topic(channel.topic, name, len(entries[channel.topic].offset), text, channel.encoding)
    return tuple(topics[name] for name in sorted(topics))
