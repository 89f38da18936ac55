"""What is known of a ROS 1 bag while it is read: its connections, chunks, and where messages lie."""

from dataclasses import dataclass, field
from typing import NamedTuple

from stone_recordings.bags.chunks import Chunk
from stone_recordings.bags.errors import MalformedBagError
from stone_recordings.bags.message_places import GrowingEntries
from stone_recordings.bags.ros1 import records as wire
from stone_recordings.bags.ros1.records import Ros1Record

COMPRESSIONS = ("bz2", "lz4")
OF_FILE = -1  # the chunk of what lies in none


class Ros1Type(NamedTuple):
    """A type as a connection tells it: package/Name, and its definition, "" for none."""

    name: str
    definition: str


@dataclass(frozen=True)
class Ros1Connection:
    """A publisher of a topic, and how it describes its messages."""

    topic: str
    type: Ros1Type


@dataclass
class Ros1Draft:
    """`starts` are where the index says that chunks begin; `losses` is in words what was broken."""

    connections: dict[int, Ros1Connection] = field(default_factory=dict)
    chunks: list[Chunk] = field(default_factory=list)
    entries: dict[int, GrowingEntries] = field(default_factory=dict)
    starts: list[int] = field(default_factory=list)
    losses: list[str] = field(default_factory=list)

    def take(self, view: memoryview, record: Ros1Record, chunk: int) -> None:
        """A message, or a connection, of a chunk whose records are `view`. Raises: MalformedBagError."""
        if record.op == wire.MESSAGE:
            time_ns = record.fields.time_ns("time")
            self.entries_of(record.fields.u32("conn")).add(time_ns, chunk, record.at)
        elif record.op == wire.CONNECTION:
            told = wire.header_fields(view[record.start : record.stop], record.fields.where)
            topic = record.fields.text("topic") or told.text("topic")
            connection = Ros1Connection(topic, Ros1Type(told.text("type"), told.text("message_definition")))
            self.define(record.fields.u32("conn"), connection, record.fields.where)

    def define(self, number: int, connection: Ros1Connection, where: str) -> None:
        """Raises: MalformedBagError where the same id says two things."""
        if self.connections.setdefault(number, connection) != connection:
            raise MalformedBagError(where, f"connection {number} is described twice, differently")

    def add_chunk(self, chunk: Chunk, found: "Ros1Draft") -> None:
        """A chunk, and what was found in it under its number. Raises: as `define`."""
        for number, connection in found.connections.items():
            self.define(number, connection, chunk.where)
        self.chunks.append(chunk)
        for number, entries in found.entries.items():
            self.entries_of(number).join(entries)

    def entries_of(self, connection_id: int) -> GrowingEntries:
        return self.entries.setdefault(connection_id, GrowingEntries())

    def undefined(self) -> list[int]:
        """Connections that messages speak of, and that are nowhere described."""
        return sorted(self.entries.keys() - self.connections.keys())


def chunk_of(record: Ros1Record, name: str) -> Chunk:
    """Raises: MalformedBagError (its header does not say how large it is)."""
    told = record.fields.text("compression")
    compression = "" if told == "none" else told or "no name"
    where = f"{name}, chunk at byte {record.at}"
    return Chunk(where, record.fields.u32("size"), 0, compression, record.start, record.stop, known=COMPRESSIONS)
