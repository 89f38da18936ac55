"""The MCAP wire format: walk records and read their fields, trusting no length.

**Conventions.** A record is one opcode byte, a u64 length and that many bytes; everything is little-endian. `where` is
the subject of the sentence about an invalid record ("run.mcap, chunk at byte 43"). Every length is checked against the
end of its container before anything is read or allocated. Source: mcap.dev/spec.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from struct import Struct

from stone_recordings.bags.chunks import Chunk
from stone_recordings.bags.errors import MalformedBagError

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK = 1, 2, 3, 4, 5, 6
MESSAGE_INDEX, CHUNK_INDEX, STATISTICS, DATA_END = 7, 8, 11, 15
PREFIX_BYTES = 9
MESSAGE_HEAD_BYTES = 22  # channel u16, sequence u32, log time u64, publish time u64
LAST_LOG_TIME_NS = (1 << 63) - 1

_U16, _U32, _U64 = Struct("<H"), Struct("<I"), Struct("<Q")
_PREFIX = Struct("<BQ")


@dataclass(frozen=True, slots=True)
class Record:
    """Opcode and the half-open byte range of the content."""

    opcode: int
    start: int
    stop: int


@dataclass(frozen=True)
class Schema:
    name: str
    encoding: str
    text: str


@dataclass(frozen=True)
class McapChannel:
    schema_id: int
    topic: str
    encoding: str


@dataclass(frozen=True)
class ChunkIndex:
    chunk_offset: int
    message_index_offsets: tuple[tuple[int, int], ...]
    message_index_bytes: int
    chunk_bytes: int

    @property
    def stop(self) -> int:
        """Return the end of the message indexes of the chunk."""
        return self.chunk_offset + self.chunk_bytes + self.message_index_bytes


@dataclass(frozen=True)
class Statistics:
    message_count: int
    chunk_count: int


class Fields:
    """Reads fields one after the other inside one record."""

    def __init__(self, view: memoryview, record: Record, where: str) -> None:
        self.view, self.at, self.stop, self.where = view, record.start, record.stop, where

    def _take(self, size: int) -> int:
        start = self.at
        if size > self.stop - start:
            problem = f"a field of {size} bytes at byte {start} overruns its record, which ends at {self.stop}"
            raise MalformedBagError(self.where, problem)
        self.at = start + size
        return start

    def u16(self) -> int:
        return int(_U16.unpack_from(self.view, self._take(2))[0])

    def u32(self) -> int:
        return int(_U32.unpack_from(self.view, self._take(4))[0])

    def u64(self) -> int:
        return int(_U64.unpack_from(self.view, self._take(8))[0])

    def span(self, size: int) -> tuple[int, int]:
        """Return the next `size` bytes as a half-open range."""
        start = self._take(size)
        return start, start + size

    def text(self) -> str:
        start, stop = self.span(self.u32())
        try:
            return bytes(self.view[start:stop]).decode()
        except UnicodeDecodeError:
            raise MalformedBagError(self.where, f"the text at byte {start} is not UTF-8") from None


def record_at(view: memoryview, offset: int, stop: int, where: str) -> Record:
    """Return the record that starts at `offset` and must end by `stop`."""
    if not 0 <= offset <= stop - PREFIX_BYTES:
        raise MalformedBagError(where, f"a record is declared at byte {offset}, the data ends at {stop}")
    opcode, length = _PREFIX.unpack_from(view, offset)
    start = offset + PREFIX_BYTES
    if opcode == 0 or length > stop - start:
        problem = f"the record at byte {offset} (opcode {opcode}) declares {length} bytes, {stop - start} are left"
        raise MalformedBagError(where, problem)
    return Record(opcode, start, start + length)


def walk(view: memoryview, start: int, stop: int, where: str) -> Iterator[Record]:
    """Yield every record from `start` to exactly `stop`."""
    while start < stop:
        record = record_at(view, start, stop, where)
        yield record
        start = record.stop


def read_schema(fields: Fields) -> tuple[int, Schema]:
    schema_id, name, encoding = fields.u16(), fields.text(), fields.text()
    start, stop = fields.span(fields.u32())
    return schema_id, Schema(name, encoding, bytes(fields.view[start:stop]).decode(errors="replace"))


def read_channel(fields: Fields) -> tuple[int, McapChannel]:
    return fields.u16(), McapChannel(fields.u16(), fields.text(), fields.text())


def read_chunk(fields: Fields) -> Chunk:
    where = f"{fields.where}, chunk at byte {fields.at - PREFIX_BYTES}"
    fields.span(16)  # first and last log time: the messages contain them
    size, crc32, compression = fields.u64(), fields.u32(), fields.text()
    return Chunk(where, size, crc32, compression, *fields.span(fields.u64()))


def read_chunk_index(fields: Fields) -> ChunkIndex:
    fields.span(16)
    chunk_offset, chunk_bytes = fields.u64(), fields.u64()
    _start, stop = fields.span(fields.u32())
    fields.at = _start
    offsets = []
    while fields.at < stop:
        offsets.append((fields.u16(), fields.u64()))
    return ChunkIndex(chunk_offset, tuple(offsets), fields.u64(), chunk_bytes)


def read_statistics(fields: Fields) -> Statistics:
    message_count = fields.u64()
    fields.span(2 + 4 + 4 + 4)  # schemas, channels, attachments, metadata
    return Statistics(message_count, fields.u32())
