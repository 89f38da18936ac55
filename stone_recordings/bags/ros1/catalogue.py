"""Places of all messages of a ROS 1 bag: from the index at its end, else by walking the whole file.

**Conventions.** As `stone_recordings.bags.message_places`. The index is used only if it agrees with itself and with the
heads of the chunks. If anything is missing or contradictory, the file is walked, and only its records count. So a bag
that its recorder did not close, or whose end is missing, is walked on every opening.
"""

from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stone_recordings.bags.chunks import UNDOUBTED_BYTES, Chunk, inflate, pieces_of
from stone_recordings.bags.errors import CutBagError, IngestError, MalformedBagError
from stone_recordings.bags.message_places import Entries, GrowingEntries
from stone_recordings.bags.ros1 import records as wire
from stone_recordings.bags.ros1.records import Ros1Record

# A walk through a ROS 1 bag, record after record, up to its last whole one, from which an index is rebuilt. At an
# invalid record the walk continues at the next known start of a chunk; without one it ends. A chunk is taken whole or
# not at all. An unfinished chunk counts as far as it inflates; if it is plain, its records are walked like those of the
# file itself.


class Ros1Walk:
    """`draft` is the result, `read_bytes` the end of the last whole record."""

    def __init__(self, view: memoryview, name: str, starts: Sequence[int], *, is_tolerant: bool) -> None:
        self.draft, self.read_bytes = Ros1Draft(starts=sorted(starts)), 0
        self._view, self._name, self._is_tolerant = view, name, is_tolerant

    def follow(self, at: int) -> None:
        """Walk from the record at `at`. Raises: MalformedBagError and the errors of `inflate`, unless it is
        tolerant.
        """
        following: int | None = at
        while following is not None:
            self.read_bytes = following
            following = self._step(following) if following < len(self._view) else None
        for number in self.draft.undefined():
            self._lose(MalformedBagError(self._name, f"connection {number} is used and not defined"))
            del self.draft.entries[number]

    def _step(self, at: int) -> int | None:
        """Take the record at `at`; return the start of the next one, None without one."""
        record = self._head_at(at)
        if record is None:
            return self._resumed(at)
        if record.op == wire.CHUNK and self._is_begun(record):
            return self._resumed(at) if self._known_after(at) is not None else self._begun(record)
        if record.stop > len(self._view):
            return self._resumed(at)
        try:
            self._take(record)
        except IngestError as error:
            self._lose(error)
        return record.stop

    def _head_at(self, at: int) -> Ros1Record | None:
        try:
            record = wire.head_at(self._view, at, self._name)
        except MalformedBagError:
            return None
        return record if wire.MESSAGE <= record.op <= wire.CONNECTION else None

    def _is_begun(self, record: Ros1Record) -> bool:
        """Return whether a chunk is unfinished: the file ends in it, or its recorder has not written its length yet."""
        is_unsaid = record.start == record.stop and self._head_at(record.stop) is None
        return is_unsaid or record.stop > len(self._view)

    def _take(self, record: Ros1Record) -> None:
        if record.op != wire.CHUNK:
            self.draft.take(self._view, record, OF_FILE)
            return
        chunk = chunk_of(record, self._name)
        records, content = inflate(self._view, chunk), Ros1Draft()
        for inner in _records(records, chunk.where):
            content.take(records, inner, len(self.draft.chunks))
        self.draft.add_chunk(chunk, content)

    def _begun(self, record: Ros1Record) -> int | None:
        """Take the whole records of an unfinished chunk."""
        chunk, content, size_bytes = chunk_of(record, self._name), Ros1Draft(), 0
        if not chunk.compression:
            return record.start
        records = _inflated_part(self._view[record.start :], chunk.compression)
        with suppress(MalformedBagError):  # the last record is incomplete
            for inner in _records(records, chunk.where):
                content.take(records, inner, len(self.draft.chunks))
                size_bytes = inner.stop
        if size_bytes:
            part = replace(chunk, uncompressed_bytes=size_bytes, stop=len(self._view), is_cut=True)
            self.draft.add_chunk(part, content)
        return None

    def _resumed(self, at: int) -> int | None:
        """Return where the walk continues after an invalid record at `at`."""
        following = self._known_after(at)
        if following is not None:
            self._lose(MalformedBagError(self._name, f"the bytes {at} to {following} are not complete records"))
        return following

    def _known_after(self, at: int) -> int | None:
        starts = self.draft.starts
        return next(iter(starts[bisect_right(starts, at) :]), None)

    def _lose(self, error: IngestError) -> None:
        if not self._is_tolerant:
            raise error
        self.draft.losses.append(f"{str(error).partition('; ')[0]} ({error.code})")


def _records(view: memoryview, where: str) -> Iterator[Ros1Record]:
    """Yield messages and connections of a chunk. Raises: MalformedBagError for another record, or none."""
    at = 0
    while at < len(view):
        record = wire.record_at(view, at, where)
        if record.op not in (wire.MESSAGE, wire.CONNECTION):
            raise MalformedBagError(where, f"the record at byte {at} is of op {record.op}, not a message")
        yield record
        at = record.stop


def _inflated_part(packed: memoryview, compression: str) -> memoryview:
    inflated = bytearray()
    for piece in pieces_of(packed, compression):
        inflated += piece
        if len(inflated) > UNDOUBTED_BYTES:  # larger than any chunk that a recorder was still writing
            break
    return memoryview(inflated)


# The state of reading a ROS 1 bag: its connections, chunks, and places of messages.


COMPRESSIONS = ("bz2", "lz4")
OF_FILE = -1  # the chunk number of messages outside of chunks


class Ros1Type(NamedTuple):
    """A type as in a connection: package/Name, and its definition, "" for none."""

    name: str
    definition: str


@dataclass(frozen=True)
class Ros1Connection:
    """A publisher of a topic, and its description of the messages."""

    topic: str
    type: Ros1Type


@dataclass
class Ros1Draft:
    """`starts` are the starts of chunks by the index; `losses` are the faults as text."""

    connections: dict[int, Ros1Connection] = field(default_factory=dict)
    chunks: list[Chunk] = field(default_factory=list)
    entries: dict[int, GrowingEntries] = field(default_factory=dict)
    starts: list[int] = field(default_factory=list)
    losses: list[str] = field(default_factory=list)

    def take(self, view: memoryview, record: Ros1Record, chunk: int) -> None:
        """Take a message, or a connection, of a chunk whose records are `view`. Raises: MalformedBagError."""
        if record.op == wire.MESSAGE:
            time_ns = record.fields.time_ns("time")
            self.entries_of(record.fields.u32("conn")).add(time_ns, chunk, record.at)
        elif record.op == wire.CONNECTION:
            description = wire.header_fields(view[record.start : record.stop], record.fields.where)
            topic = record.fields.text("topic") or description.text("topic")
            connection = Ros1Connection(
                topic, Ros1Type(description.text("type"), description.text("message_definition"))
            )
            self.define(record.fields.u32("conn"), connection, record.fields.where)

    def define(self, number: int, connection: Ros1Connection, where: str) -> None:
        """Take a connection. Raises: MalformedBagError if the id was defined otherwise."""
        if self.connections.setdefault(number, connection) != connection:
            raise MalformedBagError(where, f"connection {number} is described twice, differently")

    def add_chunk(self, chunk: Chunk, found: "Ros1Draft") -> None:
        """Take a chunk, and its content under its number. Raises: as `define`."""
        for number, connection in found.connections.items():
            self.define(number, connection, chunk.where)
        self.chunks.append(chunk)
        for number, entries in found.entries.items():
            self.entries_of(number).join(entries)

    def entries_of(self, connection_id: int) -> GrowingEntries:
        return self.entries.setdefault(connection_id, GrowingEntries())

    def undefined(self) -> list[int]:
        """Return the connections of messages that are never defined."""
        return sorted(self.entries.keys() - self.connections.keys())


def chunk_of(record: Ros1Record, name: str) -> Chunk:
    """Return the chunk of a record. Raises: MalformedBagError (its header lacks its size)."""
    declared = record.fields.text("compression")
    compression = "" if declared == "none" else declared or "no name"
    where = f"{name}, chunk at byte {record.at}"
    return Chunk(where, record.fields.u32("size"), 0, compression, record.start, record.stop, known=COMPRESSIONS)


BAG_HEADER_BYTES = 4096  # recorders pad it to this size, to rewrite it when they close the bag


@dataclass(frozen=True, eq=False)
class BagState:
    """`is_closed`: nothing is missing after the last message. `read_bytes` of the file are whole records.

    `losses` are the earlier faults as text, for a tolerant reader.
    """

    is_indexed: bool
    is_closed: bool
    read_bytes: int
    losses: Sequence[str] = ()


@dataclass(frozen=True, eq=False)
class Ros1Catalogue:
    """The content of the bag and its places, by the number of the connection."""

    connections: Mapping[int, Ros1Connection]
    chunks: Sequence[Chunk]
    entries: Mapping[int, Entries]
    state: BagState


def read_ros1_catalogue(view: memoryview, name: str, *, is_tolerant: bool = False) -> Ros1Catalogue:
    """Return the places in a file that starts with the magic; with `is_tolerant` faults are recorded and skipped.

    Raises: CutBagError (no message is whole), `BAG-036`, MalformedBagError and the refusals of `inflate`.
    """
    header = _bag_header(view, name)
    index_at, draft = header.fields.u64("index_pos"), Ros1Draft()
    is_there = header.stop <= index_at < len(view)
    if is_there:
        try:
            return _finished(draft, BagState(True, True, read_index(view, header, draft, name)))
        except MalformedBagError:
            pass  # the walk reports faults, if any matter
    walk = Ros1Walk(view, name, draft.starts, is_tolerant=is_tolerant)
    walk.follow(header.stop)
    if is_there and walk.read_bytes < index_at and not is_tolerant:
        raise MalformedBagError(
            name, f"there is no complete record at byte {walk.read_bytes}, the index is at {index_at}"
        )
    if not walk.draft.entries and not is_there:
        raise CutBagError(name, len(view), "it has no complete message")
    is_closed = is_there and index_at <= walk.read_bytes
    return _finished(walk.draft, BagState(False, is_closed, walk.read_bytes, walk.draft.losses))


def _finished(draft: Ros1Draft, state: BagState) -> Ros1Catalogue:
    entries = {number: growing.finished() for number, growing in draft.entries.items()}
    return Ros1Catalogue(draft.connections, draft.chunks, entries, state)


def _bag_header(view: memoryview, name: str) -> Ros1Record:
    try:
        header = wire.record_at(view, len(wire.MAGIC), name)
    except MalformedBagError:
        if len(view) < len(wire.MAGIC) + BAG_HEADER_BYTES:
            raise CutBagError(name, len(view), "its first record is not complete") from None
        raise
    if header.op != wire.BAG_HEADER:
        raise MalformedBagError(name, f"its first record is of op {header.op}, not the header of a bag")
    if encryptor := header.fields.text("encryptor"):
        raise IngestError(
            "BAG-036",
            f"{name} is encrypted by {encryptor[:60]!r}, its key is not known here; decrypt it where the key is, "
            f"in ROS 1: rosbag decrypt {name}",
        )
    return header


# The index that a ROS 1 recorder writes on closing: connections, chunks, and after each chunk its messages. Raises
# MalformedBagError if it contradicts itself or the heads of the chunks.


ENTRY = np.dtype([("sec", "<u4"), ("nsec", "<u4"), ("offset", "<u4")])
VERSION = 1


@dataclass(frozen=True)
class _ChunkInfo:
    """The place of a chunk, and its number of messages by connection."""

    at: int
    counts: dict[int, int]


def read_index(view: memoryview, header: Ros1Record, draft: Ros1Draft, name: str) -> int:
    """Fill the draft; return the byte after the index."""
    infos, at = [], header.fields.u64("index_pos")
    for _ in range(header.fields.u32("conn_count")):
        record = _expected(view, at, wire.CONNECTION, name)
        draft.take(view, record, OF_FILE)
        at = record.stop
    for _ in range(header.fields.u32("chunk_count")):
        record = _expected(view, at, wire.CHUNK_INFO, name)
        infos.append(_chunk_info(view, record))
        draft.starts.append(infos[-1].at)
        at = record.stop
    reached = header.stop
    for info in sorted(infos, key=lambda info: info.at):
        if info.at < reached:
            raise MalformedBagError(name, f"the chunk at byte {info.at} overlaps the one before it")
        reached = _add_chunk(view, info, draft, name)
    if undefined := draft.undefined():
        raise MalformedBagError(name, f"its index refers to connection {undefined[0]}, which is not defined")
    return at


def _add_chunk(view: memoryview, info: _ChunkInfo, draft: Ros1Draft, name: str) -> int:
    """Take the message indexes after one chunk; return the byte after them."""
    record = _expected(view, info.at, wire.CHUNK, name)
    draft.chunks.append(chunk_of(record, name))
    counts: dict[int, int] = {}
    for _ in info.counts:
        record = _expected(view, record.stop, wire.INDEX, name)
        number, (times_ns, offsets) = record.fields.u32("conn"), _rows(view, record)
        counts[number] = counts.get(number, 0) + len(offsets)
        draft.entries_of(number).extend(times_ns, len(draft.chunks) - 1, offsets)
    if counts != info.counts:
        raise MalformedBagError(
            name, f"the index of the chunk at byte {info.at} does not have as many messages as the chunk info declares"
        )
    return record.stop


def _rows(view: memoryview, record: Ros1Record) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return times, and offsets in the chunk."""
    count, size_bytes = record.fields.u32("count"), record.stop - record.start
    if record.fields.u32("ver") != VERSION or size_bytes != count * ENTRY.itemsize:
        raise MalformedBagError(
            record.fields.where, f"the index at byte {record.at} has {size_bytes} bytes for {count}"
        )
    rows = np.frombuffer(view[record.start : record.stop], ENTRY)
    times_ns = rows["sec"].astype(np.int64) * wire.NS_PER_S + rows["nsec"]
    return times_ns, rows["offset"].astype(np.int64)


def _chunk_info(view: memoryview, record: Ros1Record) -> _ChunkInfo:
    count, data = record.fields.u32("count"), view[record.start : record.stop]
    if record.fields.u32("ver") != VERSION or len(data) != 8 * count:
        raise MalformedBagError(record.fields.where, f"the chunk info at byte {record.at} has {len(data)} bytes")
    table = np.frombuffer(data, "<u4").reshape(-1, 2).tolist()
    return _ChunkInfo(record.fields.u64("chunk_pos"), dict(table))


def _expected(view: memoryview, at: int, op: int, name: str) -> Ros1Record:
    record = wire.record_at(view, at, name)
    if record.op != op:
        raise MalformedBagError(name, f"the record at byte {at} is of op {record.op}, {op} is expected")
    return record
