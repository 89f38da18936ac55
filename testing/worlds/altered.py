"""A recording written anew with some of its messages altered: faults made of a real drive.

**Conventions.** A change gets the topic, the log time and the bytes of a message, and gives the bytes to write, a list
of them where it is to be several messages, or None where it is to be missing.
"""

from collections.abc import Callable
from pathlib import Path

from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

Change = Callable[[str, int, bytearray], bytes | list[bytes] | None]


def altered(source: Path, target: Path, change: Change, compression: CompressionType = CompressionType.NONE) -> Path:
    """`target`, an indexed MCAP of what the change makes of every message of `source`."""
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
