"""Messages of a sealed MCAP file through a memory map: nothing is copied that is not compressed.

**Conventions.** The file must not change while it is open (a mapped file that is cut raises SIGBUS). Payloads are
views into the map or into an inflated chunk and keep it alive; `close` lets go of ours, the last view of theirs. Memory
is the index (20 bytes a message) and the `KEPT_CHUNKS` chunks used last: neighbours in time may lie in two.
"""

import mmap
from collections import OrderedDict
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from struct import Struct

import numpy as np
from numpy.typing import NDArray

from services.ingest import mcap_records as wire
from services.ingest.errors import EncodingRefusedError, MalformedBagError
from services.ingest.mcap_catalogue import Catalogue, Entries, message_head, read_catalogue
from services.ingest.mcap_chunks import check_crc32, inflate
from services.ingest.topic import Topic
from stone.findings import Finding

KEPT_CHUNKS = 2
_MESSAGE = Struct("<BQHIQQ")  # a record's opcode and length, then a message's head
FORGET_BYTES = 64 * 2**20  # how far to read on before giving back pages that may have been looked at late


class McapStore:
    """One open MCAP file; `is_indexed` is False where the whole file had to be walked."""

    findings: tuple[Finding, ...] = ()

    def __init__(self, path: Path) -> None:
        with path.open("rb") as file:
            self._map = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        self._view = memoryview(self._map)
        self._name = path.name
        self._catalogue = read_catalogue(self._view, self._name)
        self._chunks: OrderedDict[int, memoryview] = OrderedDict()
        self._checked: set[int] = set()
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
        """Storage order, so that each chunk is inflated once; plain chunks are not read whole for it.

        Every payload is whole: a view costs nothing that is not touched.
        """
        parts = [self._entries[topic] for topic in topics]
        if not parts:
            return
        number = np.concatenate([np.full(len(part.offset), number) for number, part in enumerate(parts)])
        index = np.concatenate([np.arange(len(part.offset)) for part in parts])
        chunk = np.concatenate([part.chunk for part in parts])
        order = np.lexsort((np.concatenate([part.offset for part in parts]), chunk))
        # Without it the kernel reads ahead around every header: a scan of a cold file takes 85 times as long.
        self._map.madvise(mmap.MADV_RANDOM)
        try:
            for row in order.tolist():
                topic = topics[number[row]]
                yield topic, int(index[row]), self._payload(topic, int(index[row]), is_checked=False)
        finally:
            self._map.madvise(mmap.MADV_NORMAL)

    def release(self) -> None:
        self._chunks.clear()

    def close(self) -> None:
        self._chunks.clear()
        self._view = memoryview(b"")

    def _payload(self, topic: str, index: int, *, is_checked: bool) -> memoryview:
        entries = self._entries[topic]
        number, offset = int(entries.chunk[index]), int(entries.offset[index])
        if number < 0 and abs(offset - self._near_byte) > FORGET_BYTES:
            self._forget(0, len(self._map))
            self._near_byte = offset
        view = self._view if number < 0 else self._records(number, is_checked)
        if 0 <= offset <= len(view) - _MESSAGE.size:
            opcode, length, channel_id, _sequence, log_time_ns, _published_ns = _MESSAGE.unpack_from(view, offset)
            start, stop = offset + _MESSAGE.size, offset + wire.PREFIX_BYTES + length
            is_promised = self._topic_of.get(channel_id) == topic and log_time_ns == entries.log_time_ns[index]
            if opcode == wire.MESSAGE and start <= stop <= len(view) and is_promised:
                return view[start:stop]
        raise self._broken_promise(view, number, offset)

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
