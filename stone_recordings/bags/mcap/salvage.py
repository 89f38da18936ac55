"""Salvage of a truncated or damaged MCAP file: its complete records in the order of the file, up to where it ends.

**Conventions.** The file is walked record by record; it may lack an index. Where a record cannot be one, or reaches
into what the summary knows to be the next chunk, the walk goes on at the next place that the summary knows
(`stone_recordings.bags.mcap.known_places`), and the bytes between are a loss. A complete chunk is taken whole or, where
it fails its checksum or does not inflate, left out: its messages cannot be trusted. Of the chunk that the cut went
through, whatever inflates is read record by record; nothing can check those. Memory is one chunk.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from struct import Struct

from stone_recordings.bags.chunks import CHUNK_LIMIT_BYTES, Chunk, check_crc32, inflate, pieces_of
from stone_recordings.bags.errors import IngestError, MalformedBagError
from stone_recordings.bags.mcap import records as wire
from stone_recordings.bags.mcap.known_places import KnownPlaces
from stone_recordings.bags.mcap.records import Fields, Record

_PREFIX = Struct("<BQ")
MOST_PROBLEMS = 4


@dataclass
class Losses:
    """What `complete_records` could not read, filled while it runs.

    `stop_byte` is where the first record begins that is not complete; `is_sealed`: the data section ended as it should.
    `told_messages` is how many the summary counts, None where nothing says so.
    """

    stop_byte: int = 0
    is_sealed: bool = False
    problems: list[str] = field(default_factory=list)
    unsaid: int = 0
    told_messages: int | None = None

    def add(self, problem: str) -> None:
        """The first few are kept in words, the rest counted."""
        if len(self.problems) < MOST_PROBLEMS:
            self.problems.append(problem)
        else:
            self.unsaid += 1

    def refuse(self, error: IngestError) -> None:
        """A problem that was met as a refusal: what is wrong, without what one could do about it."""
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
    """Records of the data section, those inside chunks instead of the chunks; `view` begins with the magic."""
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
        found = SalvagedRecord(view, record, name)
        if record.opcode == wire.CHUNK:
            yield from _of_chunk(found, known.chunks.get(losses.stop_byte), losses)
        else:
            yield found
        losses.stop_byte = record.stop


def first_compression(view: memoryview, name: str, known: KnownPlaces | None = None) -> str:
    """How the first chunk is packed; "" where messages come first, or nothing does."""
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


def _of_chunk(found: SalvagedRecord, known: Chunk | None, losses: Losses) -> Iterator[SalvagedRecord]:
    """`known` is what the summary says of it, where it does: the chunk's own head may be damaged."""
    try:
        chunk = known or wire.read_chunk(found.fields())
        records = inflate(found.view, chunk)
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
    """Whatever records come out of the chunk at `losses.stop_byte` before its bytes end; none of any other record."""
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
        """The records that `piece` completes; what is no record, or larger than any chunk, ends the stream."""
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
