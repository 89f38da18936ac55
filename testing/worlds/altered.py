"""A recording with some of its messages altered: faults in a real drive.

**Conventions.** A change receives the topic, the log time and the bytes of a message. It returns the bytes to write, a
list of bytes for several messages, or None to drop the message.
"""

from collections.abc import Callable
from pathlib import Path

from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

Change = Callable[[str, int, bytearray], bytes | list[bytes] | None]


def altered(source: Path, target: Path, change: Change, compression: CompressionType = CompressionType.NONE) -> Path:
    """Write `target`, an indexed MCAP with the change applied to every message of `source`; return its path."""
    with source.open("rb") as reading, target.open("wb") as writing:
        writer = Writer(writing, compression=compression)
        writer.start("ros2", library="altered")
        channels: dict[int, int] = {}
        for schema, channel, message in make_reader(reading).iter_messages():
            if channel.id not in channels and schema is not None:
                schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, schema_id)
            made = change(channel.topic, message.log_time, bytearray(message.data))
            where, times = channels[channel.id], (message.log_time, message.publish_time)
            for data in made if isinstance(made, list) else [] if made is None else [made]:
                writer.add_message(where, times[0], bytes(data), times[1], message.sequence)
        writer.finish()  # type: ignore[no-untyped-call]
    return target
