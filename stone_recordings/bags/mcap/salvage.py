"""Salvage of a truncated or damaged MCAP file: its complete records in file order.

**Conventions.** The file is walked record by record; it may lack an index. If a record is invalid, or reaches into a
chunk that the summary locates, the walk continues at the next known place (below); the bytes between are a loss. A
complete chunk is taken whole, or left out if it fails its checksum or does not inflate, because its messages cannot be
trusted. The part of a cut chunk that inflates is read record by record, unchecked. Memory is one chunk.
"""

import zlib
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from struct import Struct

import numpy as np

from stone_recordings.bags.chunks import CHUNK_LIMIT_BYTES, Chunk, check_crc32, inflate, pieces_of
from stone_recordings.bags.errors import IngestError, MalformedBagError
from stone_recordings.bags.mcap import records as wire
from stone_recordings.bags.mcap.extras import ATTACHMENT, METADATA
from stone_recordings.bags.mcap.records import Fields, Record

# Places of the records of a damaged MCAP file, as far as the summary at its end is readable. Places are bytes of the
# file. A chunk is known if its own head repeats its index entry, except the record's length. It is also known with a
# damaged head, if the length is right and the summary matches its checksum. A summary that fails its checksum names no
# channels. Source: mcap.dev/spec.


FOOTER_BYTES = wire.PREFIX_BYTES + 20
DATA_END_BYTES = wire.PREFIX_BYTES + 4
# The size of a chunk's head without the name of its compression: times, size, checksum, and the lengths of name and
# records.
CHUNK_HEAD_BYTES = 8 + 8 + 8 + 4 + 4 + 8
# This number of valid records in a row is no accident of a payload's bytes.
LEAST_CHAIN = 3
# Opcodes of the data section; from the second on they are reserved for private use.
OF_DATA = frozenset(
    {wire.HEADER, wire.SCHEMA, wire.CHANNEL, wire.MESSAGE, wire.CHUNK, wire.MESSAGE_INDEX, wire.DATA_END}
)
OF_DATA |= {ATTACHMENT, METADATA}
FIRST_PRIVATE = 0x80
# The next message is usually near, and a file may be damaged in many places.
LEAST_WINDOW_BYTES, LAST_WINDOW_BYTES = 1 << 12, 1 << 20
_PLACE_PREFIX, _MESSAGE = Struct("<BQ"), Struct("<HIQ")


@dataclass(frozen=True)
class KnownPlaces:
    """`chunks` by the start of their record; `data_stop` is the start of the data section's last record.

    `data_stop` is None without a summary. `messages` is their number and `times_ns` the first and last log time, None
    if unknown; `definitions` are the schemas and channels by opcode and id.
    """

    chunks: dict[int, Chunk] = field(default_factory=dict)
    data_stop: int | None = None
    messages: int | None = None
    times_ns: tuple[int, int] | None = None
    definitions: dict[tuple[int, int], Record] = field(default_factory=dict)

    @cached_property
    def starts(self) -> list[int]:
        """The starts of the known chunks, ascending."""
        return sorted(self.chunks)

    def record_at(self, view: memoryview, at: int) -> Record | None:
        """Return the record of the data section that starts there; None without a whole one.

        The index gives the end of a known chunk.
        """
        start = at + wire.PREFIX_BYTES
        if at in self.chunks:
            return Record(wire.CHUNK, start, self.chunks[at].stop)
        if start > len(view):
            return None
        opcode, length = _PLACE_PREFIX.unpack_from(view, at)
        if opcode == 0 or length > self._limit_after(at, len(view)) - start:
            return None
        is_early = opcode == wire.DATA_END and self.data_stop not in (None, at)
        is_data = self.data_stop is None or opcode in OF_DATA or opcode >= FIRST_PRIVATE
        return Record(opcode, start, start + length) if is_data and not is_early else None

    def is_followed(self, view: memoryview, record: Record) -> bool:
        """Return whether another record starts at the end of this one, even one with a damaged head.

        A chunk always passes: it has a checksum, or an index entry with its end.
        """
        at = record.stop
        if (
            self.data_stop is None
            or record.opcode == wire.CHUNK
            or at > self.data_stop
            or self.record_at(view, at) is not None
        ):
            return True
        if at + wire.PREFIX_BYTES > self.data_stop:
            return False
        opcode, length = _PLACE_PREFIX.unpack_from(view, at)
        start = at + wire.PREFIX_BYTES
        if opcode == wire.MESSAGE and self._is_head(view, start):
            return True
        return bool(length < self.data_stop - start and self._begins_chain(view, start + length))

    def next_after(self, view: memoryview, at: int) -> int | None:
        """Return the start of the next record that is certain to be one; None if none is known."""
        if self.data_stop is None or at >= self.data_stop:
            return None
        if self.starts:
            return next(iter(self.starts[bisect_right(self.starts, at) :]), self.data_stop)
        return next(self._messages_after(view, at), self.data_stop)

    def _limit_after(self, at: int, size: int) -> int:
        """Return the limit of a record that starts at `at` in a file of `size` bytes."""
        if self.data_stop is None or at >= self.data_stop:
            return size
        following = bisect_right(self.starts, at)
        return self.starts[following] if following < len(self.starts) else self.data_stop

    def _is_head(self, view: memoryview, start: int) -> bool:
        """Return whether a message's head can stand there: with a channel and a log time from the summary."""
        if start + wire.MESSAGE_HEAD_BYTES > (self.data_stop or 0):
            return False
        channel_id, _sequence, time_ns = _MESSAGE.unpack_from(view, start)
        is_known = (wire.CHANNEL, channel_id) in self.definitions
        return is_known and self.times_ns is not None and self.times_ns[0] <= time_ns <= self.times_ns[1]

    def _messages_after(self, view: memoryview, at: int) -> Iterator[int]:
        """Yield places after `at` at which messages start that others follow."""
        first, last, size = at + 1, self.data_stop or 0, LEAST_WINDOW_BYTES
        while first <= last - wire.PREFIX_BYTES:
            window = np.frombuffer(view[first : min(first + size + wire.PREFIX_BYTES - 1, last)], np.uint8)
            heads = np.lib.stride_tricks.sliding_window_view(window, wire.PREFIX_BYTES)
            is_head = (heads[:, 0] == wire.MESSAGE) & (heads[:, 6:] == 0).all(axis=1)
            yield from (
                first + row for row in np.flatnonzero(is_head).tolist() if self._begins_chain(view, first + row)
            )
            first, size = first + size, min(2 * size, LAST_WINDOW_BYTES)

    def _begins_chain(self, view: memoryview, at: int) -> bool:
        for _ in range(LEAST_CHAIN):
            if at == self.data_stop:
                return True
            record = self.record_at(view, at)
            if record is None or (record.opcode == wire.MESSAGE and not self._is_head(view, record.start)):
                return False
            at = record.stop
        return True


def known_places(view: memoryview, name: str) -> KnownPlaces:
    """Return the places from the end of the file; none without a readable summary."""
    size = len(view) - len(wire.MAGIC)
    footer_offset = size - FOOTER_BYTES
    if footer_offset < len(wire.MAGIC) + DATA_END_BYTES or bytes(view[size:]) != wire.MAGIC:
        return KnownPlaces()
    try:
        footer = Fields(view, wire.record_at(view, footer_offset, size, name), name)
        start, _offsets, crc32 = footer.u64(), footer.u64(), footer.u32()
    except MalformedBagError:
        return KnownPlaces()
    start = start or footer_offset
    if not len(wire.MAGIC) + DATA_END_BYTES <= start <= footer_offset:
        return KnownPlaces()
    data_stop = start - DATA_END_BYTES
    opcode, length = _PLACE_PREFIX.unpack_from(view, data_stop)
    if opcode != wire.DATA_END or length != DATA_END_BYTES - wire.PREFIX_BYTES:
        return KnownPlaces()
    is_sound = not crc32 or zlib.crc32(view[start : size - 4]) == crc32
    trust = _Trust(is_sound, bool(crc32) and is_sound)
    return _of_summary(view, name, (start, footer_offset), data_stop, trust)


@dataclass(frozen=True)
class _Trust:
    """For a summary: `is_sound` if no checksum contradicts it, `is_proven` if a checksum confirms it."""

    is_sound: bool
    is_proven: bool


def _of_summary(view: memoryview, name: str, summary: tuple[int, int], data_stop: int, trust: _Trust) -> KnownPlaces:
    chunks: dict[int, Chunk] = {}
    definitions: dict[tuple[int, int], Record] = {}
    messages, times_ns = None, None
    try:
        for record in wire.walk(view, *summary, name):
            fields = Fields(view, record, name)
            if record.opcode == wire.CHUNK_INDEX:
                chunks.update(_known_chunk(view, fields, data_stop, trust))
            elif record.opcode == wire.STATISTICS and trust.is_sound:
                messages = wire.read_statistics(fields).message_count
                times_ns = (fields.u64(), fields.u64())
            elif record.opcode in (wire.SCHEMA, wire.CHANNEL) and trust.is_sound:
                definitions[record.opcode, fields.u16()] = record
    except MalformedBagError:
        pass  # the entries read so far stay valid: each chunk was checked
    return KnownPlaces(_apart(chunks), data_stop, messages, times_ns, definitions)


def _known_chunk(view: memoryview, index: Fields, data_stop: int, trust: _Trust) -> dict[int, Chunk]:
    """Return the chunk of an index entry by its start; {} if the entry is invalid, or the head contradicts it."""
    times_ns = (index.u64(), index.u64())
    start, length = index.u64(), index.u64()
    index.span(index.u32())
    index.u64()
    compression, packed_bytes, size_bytes = index.text(), index.u64(), index.u64()
    stop = start + length
    head_bytes = wire.PREFIX_BYTES + CHUNK_HEAD_BYTES + len(compression.encode())
    if not len(wire.MAGIC) <= start < stop <= data_stop or length != head_bytes + packed_bytes:
        return {}
    head = Fields(view, Record(wire.CHUNK, start + wire.PREFIX_BYTES, stop), index.where)
    repeated = (head.u64(), head.u64(), head.u64())
    crc32 = head.u32()
    chunk = Chunk(f"{index.where}, chunk at byte {start}", size_bytes, crc32, compression, stop - packed_bytes, stop)
    if trust.is_proven and _PLACE_PREFIX.unpack_from(view, start) == (wire.CHUNK, length - wire.PREFIX_BYTES):
        return {start: chunk}
    try:
        is_repeated = (*repeated, head.text(), head.u64()) == (*times_ns, size_bytes, compression, packed_bytes)
    except MalformedBagError:
        return {}
    return {start: chunk} if is_repeated else {}


def _apart(chunks: dict[int, Chunk]) -> dict[int, Chunk]:
    """Return the chunks that do not start inside another one."""
    kept: dict[int, Chunk] = {}
    reached = 0
    for start, chunk in sorted(chunks.items()):
        if start >= reached:
            kept[start], reached = chunk, chunk.stop
    return kept


_PREFIX = Struct("<BQ")
MOST_PROBLEMS = 4


@dataclass
class Losses:
    """The records that `complete_records` could not read, filled while it runs.

    `stop_byte` is the start of the first incomplete record; `is_sealed`: the data section ended properly.
    `told_messages` is the summary's count, None without one.
    """

    stop_byte: int = 0
    is_sealed: bool = False
    problems: list[str] = field(default_factory=list)
    unsaid: int = 0
    told_messages: int | None = None

    def add(self, problem: str) -> None:
        """Add a problem: the first few as text, the rest counted."""
        if len(self.problems) < MOST_PROBLEMS:
            self.problems.append(problem)
        else:
            self.unsaid += 1

    def refuse(self, error: IngestError) -> None:
        """Add a problem from a refusal: the fault, without the remedy."""
        self.add(f"{str(error).partition('; ')[0]} ({error.code})")


@dataclass(frozen=True, slots=True)
class SalvagedRecord:
    """One complete record; `fields()` reads it once."""

    view: memoryview
    record: Record
    where: str

    def fields(self) -> Fields:
        return Fields(self.view, self.record, self.where)


def complete_records(
    view: memoryview, name: str, losses: Losses, known: KnownPlaces | None = None
) -> Iterator[SalvagedRecord]:
    """Yield the records of the data section, those inside chunks instead of the chunks; `view` starts with the
    magic.
    """
    known = known or KnownPlaces()
    losses.stop_byte = len(wire.MAGIC)
    while losses.stop_byte + wire.PREFIX_BYTES <= len(view):
        record = known.record_at(view, losses.stop_byte)
        if record is None or not known.is_followed(view, record):
            resumed = known.next_after(view, losses.stop_byte)
            if resumed is None:
                yield from _of_cut_chunk(view, name, losses)
                return
            losses.add(f"the bytes {losses.stop_byte} to {resumed} of {name}, which are not complete records")
            losses.stop_byte = resumed
            continue
        if record.opcode == wire.DATA_END:
            losses.is_sealed = True
            return
        salvaged = SalvagedRecord(view, record, name)
        if record.opcode == wire.CHUNK:
            yield from _of_chunk(salvaged, known.chunks.get(losses.stop_byte), losses)
        else:
            yield salvaged
        losses.stop_byte = record.stop


def first_compression(view: memoryview, name: str, known: KnownPlaces | None = None) -> str:
    """Return the compression of the first chunk; "" if messages come first, or nothing does."""
    if known is not None and known.chunks:
        return known.chunks[known.starts[0]].compression
    at = len(wire.MAGIC)
    while at + wire.PREFIX_BYTES <= len(view):
        opcode, length = _PREFIX.unpack_from(view, at)
        if opcode == wire.CHUNK:
            return _compression_at(view, at, name)
        at += wire.PREFIX_BYTES + length
        if opcode in (0, wire.MESSAGE, wire.DATA_END):
            return ""
    return ""


def _compression_at(view: memoryview, at: int, name: str) -> str:
    fields = Fields(view, Record(wire.CHUNK, at + wire.PREFIX_BYTES, len(view)), name)
    try:
        fields.span(16 + 8 + 4)
        return fields.text()
    except MalformedBagError:  # cut inside the chunk's own head
        return ""


def _of_chunk(salvaged: SalvagedRecord, known: Chunk | None, losses: Losses) -> Iterator[SalvagedRecord]:
    """Yield the records of a chunk; `known` is its entry in the summary, if any: the chunk's own head may be
    damaged.
    """
    try:
        chunk = known or wire.read_chunk(salvaged.fields())
        records = inflate(salvaged.view, chunk)
        if not chunk.compression:
            check_crc32(records, chunk)
        whole = [
            SalvagedRecord(records, record, chunk.where) for record in wire.walk(records, 0, len(records), chunk.where)
        ]
    except IngestError as error:
        losses.refuse(error)
        return
    yield from whole


def _of_cut_chunk(view: memoryview, name: str, losses: Losses) -> Iterator[SalvagedRecord]:
    """Yield the records of the chunk at `losses.stop_byte` before its bytes end; none for another kind of record."""
    if view[losses.stop_byte] != wire.CHUNK:
        return
    fields = Fields(view, Record(wire.CHUNK, losses.stop_byte + wire.PREFIX_BYTES, len(view)), name)
    try:
        fields.span(16 + 8 + 4)
        compression = fields.text()
        fields.u64()
    except MalformedBagError:
        return
    where = f"{name}, the chunk at byte {losses.stop_byte} that was cut off"
    stream = _RecordStream(where)
    for piece in pieces_of(view[fields.at :], compression):
        yield from stream.feed(piece)
        if stream.is_over:
            return


class _RecordStream:
    """Records out of pieces of any size; memory is one piece and one record, and no record is copied twice."""

    def __init__(self, where: str) -> None:
        self.is_over = False
        self._where, self._rest, self._needed_bytes = where, bytearray(), wire.PREFIX_BYTES

    def feed(self, piece: bytes | memoryview) -> Iterator[SalvagedRecord]:
        """Yield the records that `piece` completes; an invalid record, or one larger than any chunk, ends the
        stream.
        """
        self._rest += piece
        while len(self._rest) >= self._needed_bytes and not self.is_over:
            opcode, length = _PREFIX.unpack_from(self._rest)
            self._needed_bytes = wire.PREFIX_BYTES + length
            self.is_over = opcode == 0 or length > CHUNK_LIMIT_BYTES
            if self.is_over or len(self._rest) < self._needed_bytes:
                return
            content = memoryview(bytes(self._rest[: self._needed_bytes]))
            del self._rest[: self._needed_bytes]
            self._needed_bytes = wire.PREFIX_BYTES
            yield SalvagedRecord(content, Record(opcode, wire.PREFIX_BYTES, len(content)), self._where)
