"""Places of all messages of an MCAP file: from its summary and message indexes, else by walking the whole file.

**Conventions.** An entry is (log time, chunk number, offset of the message record in that chunk's records); chunk −1 is
the file itself, for recordings without chunks. The summary is used only if it agrees with its own statistics; if
anything is missing or contradictory, the file is walked, and only its records count.
"""

import os
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from struct import Struct
from typing import BinaryIO, TypeVar

import numpy as np

from stone_recordings.bags.chunks import Chunk, inflate
from stone_recordings.bags.errors import ChecksumError, CutBagError, MalformedBagError
from stone_recordings.bags.mcap import records as wire
from stone_recordings.bags.mcap.records import MAGIC, Fields, McapChannel, Record, Schema
from stone_recordings.bags.message_places import Entries, GrowingEntries

FOOTER_BYTES = wire.PREFIX_BYTES + 20
INDEX_ENTRY_BYTES = 16  # log time and offset, both u64
_MESSAGE_HEAD = Struct("<HIQ")
_Definition = TypeVar("_Definition", Schema, McapChannel)


@dataclass(frozen=True)
class Catalogue:
    """The content of the file and its places; `is_indexed` is whether its own index could be used."""

    schemas: dict[int, Schema]
    channels: dict[int, McapChannel]
    chunks: tuple[Chunk, ...]
    entries: dict[int, Entries]
    is_indexed: bool


@dataclass
class _Draft:
    """A catalogue under construction."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, McapChannel] = field(default_factory=dict)
    chunks: list[Chunk] = field(default_factory=list)
    entries: dict[int, GrowingEntries] = field(default_factory=dict)

    def define(self, record: Record, fields: Fields) -> None:
        """Take a schema or channel; a repeated id must have the same content."""
        if record.opcode == wire.SCHEMA:
            _define(self.schemas, *wire.read_schema(fields), fields.where)
        elif record.opcode == wire.CHANNEL:
            _define(self.channels, *wire.read_channel(fields), fields.where)

    def entries_of(self, channel_id: int) -> GrowingEntries:
        return self.entries.setdefault(channel_id, GrowingEntries())

    def missing(self) -> list[str]:
        """Return channels of messages and schemas of channels without a definition."""
        schemas = {channel.schema_id for channel in self.channels.values() if channel.schema_id}
        return [f"channel {channel_id}" for channel_id in sorted(self.entries.keys() - self.channels.keys())] + [
            f"schema {schema_id}" for schema_id in sorted(schemas - self.schemas.keys())
        ]

    def finished(self, where: str, is_indexed: bool) -> Catalogue:
        if missing := self.missing():
            raise MalformedBagError(where, f"its records refer to {missing[0]}, which is not defined")
        entries = {channel_id: growing.finished() for channel_id, growing in self.entries.items()}
        return Catalogue(self.schemas, self.channels, tuple(self.chunks), entries, is_indexed)


def read_catalogue(view: memoryview, name: str, before_walk: Callable[[], None] = lambda: None) -> Catalogue:
    """Return the index of a sealed file that starts with the MCAP magic; `before_walk` is called if all of it must be
    read.

    Raises: CutBagError (no closing magic), MalformedBagError, ChecksumError and the refusals of `inflate`.
    """
    footer = _footer(view, name)
    footer_offset = footer.start - wire.PREFIX_BYTES
    summary_offset = _summary_offset(view, footer, name)
    data = Record(0, len(wire.MAGIC), summary_offset)
    draft = _from_summary(view, data, footer_offset, name) if summary_offset < footer_offset else None
    if draft is not None:
        return draft.finished(name, is_indexed=True)
    before_walk()
    return _from_walk(view, data, name).finished(name, is_indexed=False)


def _footer(view: memoryview, name: str) -> Record:
    size = len(view)
    if size < 2 * len(wire.MAGIC) + FOOTER_BYTES or bytes(view[-len(wire.MAGIC) :]) != wire.MAGIC:
        raise CutBagError(name, size)
    footer_offset = size - len(wire.MAGIC) - FOOTER_BYTES
    footer = wire.record_at(view, footer_offset, size - len(wire.MAGIC), name)
    if footer.opcode != wire.FOOTER or footer.stop - footer.start != FOOTER_BYTES - wire.PREFIX_BYTES:
        raise MalformedBagError(name, f"there is no footer before the closing magic (opcode {footer.opcode})")
    return footer


def _summary_offset(view: memoryview, footer: Record, name: str) -> int:
    """Return the start of the summary; the footer's without one."""
    fields = Fields(view, footer, name)
    start, _offsets, crc32 = fields.u64(), fields.u64(), fields.u32()
    footer_offset = footer.start - wire.PREFIX_BYTES
    if start == 0:
        return footer_offset
    if not len(wire.MAGIC) <= start <= footer_offset:
        raise MalformedBagError(name, f"the footer puts the summary at byte {start}, the footer is at {footer_offset}")
    if crc32 and (computed := zlib.crc32(view[start : footer.stop - 4])) != crc32:
        raise ChecksumError(f"{name}, summary at byte {start}", computed, crc32)
    return start


def summary_range(view: memoryview, name: str) -> tuple[int, int] | None:
    """Return the place of the summary, footer included; None without one. Reads the footer alone. Raises as
    `read_catalogue`.
    """
    footer = _footer(view, name)
    start = Fields(view, footer, name).u64()
    if start and not len(wire.MAGIC) <= start <= footer.start:
        raise MalformedBagError(name, f"the footer puts the summary at byte {start}, the footer is at {footer.start}")
    return (start, len(view)) if start else None


def chunk_indexes_of(view: memoryview, name: str) -> list[wire.ChunkIndex]:
    """Return the chunks that the summary lists, in file order; reads the summary alone. Raises as `read_catalogue`."""
    footer = _footer(view, name)
    start, stop = _summary_offset(view, footer, name), footer.start - wire.PREFIX_BYTES
    indexes = _read_summary(view, (start, stop), name)[1]
    for index in indexes:
        if not len(wire.MAGIC) <= index.chunk_offset < index.stop <= start:
            raise MalformedBagError(name, f"the chunk index at byte {index.chunk_offset} ends past the data")
    return sorted(indexes, key=lambda index: index.chunk_offset)


def _read_summary(
    view: memoryview, at: tuple[int, int], name: str
) -> tuple[_Draft, list[wire.ChunkIndex], wire.Statistics | None]:
    draft, indexes, statistics = _Draft(), list[wire.ChunkIndex](), None
    for record in wire.walk(view, *at, name):
        fields = Fields(view, record, name)
        draft.define(record, fields)
        if record.opcode == wire.CHUNK_INDEX:
            indexes.append(wire.read_chunk_index(fields))
        elif record.opcode == wire.STATISTICS:
            statistics = wire.read_statistics(fields)
    return draft, indexes, statistics


def _from_summary(view: memoryview, data: Record, footer_offset: int, name: str) -> _Draft | None:
    """Return the catalogue from the summary; None if the summary is incomplete."""
    draft, indexes, statistics = _read_summary(view, (data.stop, footer_offset), name)
    if statistics is None or not indexes or statistics.chunk_count != len(indexes):
        return None
    reached = data.start
    for index in sorted(indexes, key=lambda index: index.chunk_offset):
        if index.chunk_offset < reached:
            raise MalformedBagError(name, f"the chunk index at byte {index.chunk_offset} overlaps the one before it")
        reached = _add_indexed_chunk(view, data, index, draft, name)
    count = sum(len(growing.offset) for growing in draft.entries.values())
    return draft if count == statistics.message_count and not draft.missing() else None


def _add_indexed_chunk(view: memoryview, data: Record, index: wire.ChunkIndex, draft: _Draft, name: str) -> int:
    """Take the message indexes of one chunk; return the byte after them."""
    record = wire.record_at(view, index.chunk_offset, data.stop, name)
    if record.opcode != wire.CHUNK:
        raise MalformedBagError(name, f"the chunk index points at byte {index.chunk_offset}, at which no chunk starts")
    draft.chunks.append(wire.read_chunk(Fields(view, record, name)))
    stop = record.stop + index.message_index_bytes
    if stop > data.stop:
        raise MalformedBagError(name, f"the message index of the chunk at byte {index.chunk_offset} ends past the data")
    for channel_id, offset in index.message_index_offsets:
        if offset < record.stop:
            raise MalformedBagError(name, f"a message index is declared at byte {offset}, inside its chunk")
        _add_message_index(view, wire.record_at(view, offset, stop, name), channel_id, draft, name)
    return stop


def _add_message_index(view: memoryview, record: Record, channel_id: int, draft: _Draft, name: str) -> None:
    fields = Fields(view, record, name)
    if record.opcode != wire.MESSAGE_INDEX or fields.u16() != channel_id:
        raise MalformedBagError(name, f"byte {record.start} holds no message index of channel {channel_id}")
    start, stop = fields.span(fields.u32())
    if (stop - start) % INDEX_ENTRY_BYTES:
        raise MalformedBagError(name, f"the message index at byte {record.start} is {stop - start} bytes, not n × 16")
    table = np.frombuffer(view[start:stop], "<i8")
    if len(table) and table.min() < 0:  # as unsigned: beyond the last valid time
        raise MalformedBagError(name, f"the message index at byte {record.start} holds times beyond the year 2262")
    draft.entries_of(channel_id).extend(table[::2], len(draft.chunks) - 1, table[1::2])


def _from_walk(view: memoryview, data: Record, name: str) -> _Draft:
    draft = _Draft()
    for record in wire.walk(view, data.start, data.stop, name):
        if record.opcode == wire.DATA_END:
            break
        if record.opcode != wire.CHUNK:
            _add_record(view, record, -1, draft, name)
            continue
        chunk = wire.read_chunk(Fields(view, record, name))
        draft.chunks.append(chunk)
        records = inflate(view, chunk)
        for inner in wire.walk(records, 0, len(records), chunk.where):
            _add_record(records, inner, len(draft.chunks) - 1, draft, chunk.where)
    return draft


def _add_record(view: memoryview, record: Record, chunk: int, draft: _Draft, where: str) -> None:
    if record.opcode != wire.MESSAGE:
        draft.define(record, Fields(view, record, where))
        return
    channel_id, log_time_ns = message_head(view, record, where)
    draft.entries_of(channel_id).add(log_time_ns, chunk, record.start - wire.PREFIX_BYTES)


def message_head(view: memoryview, record: Record, where: str) -> tuple[int, int]:
    """Return channel and log time of a message record."""
    if record.stop - record.start < wire.MESSAGE_HEAD_BYTES:
        raise MalformedBagError(where, f"the message record at byte {record.start} is shorter than its own head")
    channel_id, _sequence, log_time_ns = _MESSAGE_HEAD.unpack_from(view, record.start)
    if log_time_ns > wire.LAST_LOG_TIME_NS:
        raise MalformedBagError(where, f"the message at byte {record.start} was logged beyond the year 2262")
    return int(channel_id), int(log_time_ns)


def _define(known: dict[int, _Definition], key: int, value: _Definition, where: str) -> None:
    if known.setdefault(key, value) != value:
        raise MalformedBagError(where, f"id {key} is defined twice, as {known[key]} and as {value}"[:300])


# The end of a sealed MCAP file followed by zeros, which copying tools and allocated blocks leave.


PIECE_BYTES = 1 << 20
# No tool allocates more ahead; searching through more takes too long.
MOST_ZEROS_BYTES = 16 << 30


def sealed_bytes(file: BinaryIO) -> int | None:
    """Return the bytes up to the closing magic, without the zeros after it; None if other bytes end the file.

    The file is read, not mapped: touched pages of a map count as memory.
    """
    size = stop = file.seek(0, os.SEEK_END)
    while stop > 0 and size - stop < MOST_ZEROS_BYTES:
        start = max(0, stop - PIECE_BYTES)
        rest = len(_read(file, start, stop).rstrip(b"\0"))
        if rest:
            end = start + rest
            return end if _read(file, max(0, end - len(MAGIC)), end) == MAGIC else None
        stop = start
    return None


def _read(file: BinaryIO, start: int, stop: int) -> bytes:
    file.seek(start)
    return file.read(stop - start)
