"""Messages of a sealed MCAP file.

**Conventions.** As `stone_recordings.bags.chunked_store`; a payload is a view, because MCAP holds CDR messages.
"""

from collections.abc import Mapping
from pathlib import Path
from struct import Struct

import numpy as np
from numpy.typing import NDArray

from stone.findings import Finding
from stone_recordings.bags.chunked_store import ChunkedStore, MappedFile, PlacedMessages, behind_end
from stone_recordings.bags.chunks import Chunk
from stone_recordings.bags.errors import MalformedBagError, encoding_refused
from stone_recordings.bags.mcap import records as wire
from stone_recordings.bags.mcap.catalogue import Catalogue, message_head, read_catalogue, sealed_bytes
from stone_recordings.bags.message_places import Entries, GrowingEntries, in_log_order
from stone_recordings.bags.message_store import HEAD_BYTES, Topic

_MESSAGE = Struct("<BQHIQQ")  # a record's opcode and length, then a message's head


class McapStore(ChunkedStore):
    """One open MCAP file; `is_indexed` is False if the whole file was walked."""

    head_bytes = _MESSAGE.size + HEAD_BYTES

    def __init__(self, path: Path) -> None:
        file = MappedFile(path)
        with path.open("rb") as stream:
            file.view = file.view[: sealed_bytes(stream)]
        self.findings = _damaged_start(file.view, path.name)
        if zeros := len(file.map) - len(file.view):
            self.findings += (behind_end(zeros, is_zero=True),)
        file.read_ahead(False)  # an index is spread over the file
        catalogue = read_catalogue(file.view, path.name, lambda: file.read_ahead(True))
        super().__init__(file, PlacedMessages(catalogue.chunks, _merged_by_topic(catalogue, path.name)))
        self._topic_of = {number: channel.topic for number, channel in catalogue.channels.items()}
        self.topics = _topics(catalogue, self._entries)
        self.is_indexed = catalogue.is_indexed
        self._refuse_other_encodings()

    def chunk_of_messages(self, topic: str) -> NDArray[np.int64]:
        """Return the number of each message's chunk, in log-time order; −1 outside of chunks."""
        return self._entries[topic].chunk.astype(np.int64)

    def offset_of_messages(self, topic: str) -> NDArray[np.int64]:
        """Return the start of each message's record in its chunk."""
        return self._entries[topic].offset

    def chunk(self, number: int) -> Chunk:
        return self._placed.chunks[number]

    def size_bytes(self, topic: str, index: int) -> int:
        """Return the record's own length; for a message that `heads` has just inflated this reads nothing."""
        number, offset = self._place(topic, index)
        return int(_MESSAGE.unpack_from(self._seen_head(number), offset)[1]) - (_MESSAGE.size - wire.PREFIX_BYTES)

    def _found(self, view: memoryview, topic: str, index: int) -> memoryview:
        number, offset = self._place(topic, index)
        if 0 <= offset <= len(view) - _MESSAGE.size:
            opcode, length, channel_id, _sequence, log_time_ns, _published_ns = _MESSAGE.unpack_from(view, offset)
            start, stop = offset + _MESSAGE.size, offset + wire.PREFIX_BYTES + length
            is_promised = self._topic_of.get(channel_id) == topic
            is_promised &= log_time_ns == self._entries[topic].log_time_ns[index]
            if opcode == wire.MESSAGE and start <= stop <= self._size_of(number) and is_promised:
                return view[start:stop]
        raise self._broken_promise(self._records(number, is_checked=False), number, offset)

    def _broken_promise(self, view: memoryview, number: int, offset: int) -> MalformedBagError:
        """Return the error for a place at which the index promises a message and another record stands."""
        where = self._where(number)
        try:
            record = wire.record_at(view, offset, len(view), where)
            if record.opcode != wire.MESSAGE:
                return MalformedBagError(where, f"the index points at byte {offset}, at which no message starts")
            message_head(view, record, where)
        except MalformedBagError as error:
            return error
        return MalformedBagError(where, f"the message at byte {offset} is not the one that the index lists")

    def _refuse_other_encodings(self) -> None:
        other = [topic for topic in self.topics if topic.encoding != "cdr"]
        if other and len(other) == len(self.topics):
            raise encoding_refused(self._file.name, other[0].name, other[0].encoding)


def _damaged_start(view: memoryview, name: str) -> tuple[Finding, ...]:
    if view[: len(wire.MAGIC)] == wire.MAGIC:
        return ()
    message = (
        "The start of the file is damaged: its first bytes are not those of an MCAP file, its last are. "
        f"The messages in its summary are read; for other programs: stone recover {name} -o recovered.mcap."
    )
    return (Finding("BAG-033", "warning", "", message),)


def _merged_by_topic(catalogue: Catalogue, name: str) -> dict[str, Entries]:
    """Return entries in log-time order (ties: file order); several channels may carry one topic, of one type."""
    parts: dict[str, list[Entries]] = {}
    meaning: dict[str, tuple[str, str]] = {}
    for channel_id, channel in sorted(catalogue.channels.items()):
        described = (_type_of(catalogue, channel_id), channel.encoding)
        if meaning.setdefault(channel.topic, described) != described:
            raise MalformedBagError(
                name, f"topic {channel.topic!r} is recorded both as {meaning[channel.topic]} and {described}"
            )
        empty = GrowingEntries().finished()
        parts.setdefault(channel.topic, []).append(catalogue.entries.get(channel_id, empty))
    return {topic: in_log_order(listed) for topic, listed in parts.items()}


def _type_of(catalogue: Catalogue, channel_id: int) -> str:
    schema = catalogue.schemas.get(catalogue.channels[channel_id].schema_id)
    return schema.name if schema else ""


def _topics(catalogue: Catalogue, entries: Mapping[str, Entries]) -> tuple[Topic, ...]:
    topics = {}
    for channel in catalogue.channels.values():
        schema = catalogue.schemas.get(channel.schema_id)
        name, text = (schema.name, schema.text) if schema else ("", "")
        topics[channel.topic] = Topic(channel.topic, name, len(entries[channel.topic].offset), text, channel.encoding)
    return tuple(topics[name] for name in sorted(topics))
