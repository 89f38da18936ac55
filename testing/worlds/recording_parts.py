"""A recording rewritten as several files with different topics, each file on a clock of its own.

**Conventions.** A part's clock is `ahead_ns` ahead: its log times and the stamps of its messages are that much later.
The files are written by `mcap` and `rosbags`; stamps are moved in the bytes, independently of the code that moves them
back. A name that ends in `.bag` is written as ROS 1 would.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from struct import Struct

from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from testing.worlds.ros1_bags import as_ros1

STAMP = Struct("<II")
STAMP_AT = 4
NS_PER_S = 1_000_000_000
HEADERLESS = ("/tf", "/tf_static")


@dataclass(frozen=True)
class RecordingPart:
    """A file of the run: messages whose topic and log time `holds` accepts."""

    name: str
    holds: Callable[[str, int], bool]
    ahead_ns: int = 0


def split_into(source: Path, folder: Path, parts: Sequence[RecordingPart]) -> tuple[Path, ...]:
    """Write the files and return their paths, in order of the parts."""
    return tuple(_written(source, folder, part) for part in parts)


def _written(source: Path, folder: Path, part: RecordingPart) -> Path:
    target = folder / part.name
    target.unlink(missing_ok=True)
    written = target if target.suffix == ".mcap" else target.with_suffix(".tmp")
    with source.open("rb") as reading, written.open("wb") as writing:
        writer = Writer(writing, compression=CompressionType.LZ4)
        writer.start("ros2", library="parts")
        channels: dict[int, int] = {}
        for schema, channel, message in make_reader(reading).iter_messages():
            if schema is None or not part.holds(channel.topic, message.log_time):
                continue
            if channel.id not in channels:
                schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, schema_id)
            data = moved_stamp(message.data, 0 if channel.topic in HEADERLESS else part.ahead_ns)
            time_ns = message.log_time + part.ahead_ns
            writer.add_message(channels[channel.id], time_ns, data, time_ns, message.sequence)
        writer.finish()  # type: ignore[no-untyped-call]
    if written != target:
        as_ros1(written, target)
        written.unlink()
    return target


def moved_stamp(data: bytes, ahead_ns: int) -> bytes:
    """Return a message that starts with a header, with a later stamp."""
    if not ahead_ns:
        return data
    sec, nanosec = STAMP.unpack_from(data, STAMP_AT)
    moved = bytearray(data)
    STAMP.pack_into(moved, STAMP_AT, *divmod(sec * NS_PER_S + nanosec + ahead_ns, NS_PER_S))
    return bytes(moved)
