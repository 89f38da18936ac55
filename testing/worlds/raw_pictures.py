"""A recording rewritten with uncompressed pictures: most of its bytes are raw images.

**Conventions.** The target is an MCAP (chunks of 4 MiB, which a picture ends), or a rosbag2 database whose rows lie
topic after topic. Pictures are the source's, or noise of the given size. Everything else is as in the source.
"""

import sqlite3
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray

from stone_recordings.messages.camera import picture_of
from stone_recordings.messages.types.registry import message_definition

Recorded = tuple[str, str, int, bytes]  # topic, type, log time (ns), payload
PICTURE, RAW = "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/Image"
TABLES = """CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,
 serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL);
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,
 data BLOB NOT NULL);
CREATE INDEX timestamp_idx ON messages (timestamp ASC);"""


def with_raw_pictures(source: Path, target: Path, size_px: tuple[int, int] | None = None) -> Path:
    """Write the recording to `target`, an .mcap or .db3, with raw pictures: decoded ones, or noise of `size_px`."""
    writing = _written_database if target.suffix == ".db3" else _written_mcap
    writing(target, source, size_px)
    return target


def _messages(source: Path, size_px: tuple[int, int] | None) -> Iterator[Recorded]:
    noise = np.zeros((0, 0, 3), np.uint8)
    if size_px is not None:
        noise = np.random.default_rng(1).integers(0, 256, (size_px[1], size_px[0], 3), np.uint8)
    with source.open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            name = schema.name if schema else ""
            data = message.data
            if name == PICTURE:
                data = _raw(data, noise if size_px else picture_of(PICTURE, memoryview(data)))
            yield channel.topic, RAW if name == PICTURE else name, message.log_time, data


def _raw(payload: bytes, pixels: NDArray[np.uint8]) -> bytes:
    """Return the image (H, W, 3) with the header of a compressed one."""
    (length,) = struct.unpack_from("<I", payload, 12)
    head = payload[: 16 + length]
    head += bytes(-(len(head) - 4) % 4) + struct.pack("<III", pixels.shape[0], pixels.shape[1], 5) + b"rgb8\0" + b"\0"
    head += bytes(-(len(head) - 4) % 4) + struct.pack("<II", 3 * pixels.shape[1], pixels.size)
    return head + pixels.tobytes()


def _written_mcap(target: Path, source: Path, size_px: tuple[int, int] | None) -> None:
    with target.open("wb") as stream:
        writer = Writer(stream, chunk_size=4 << 20, compression=CompressionType.NONE)
        writer.start("ros2", library="raw")
        channels = dict[str, int]()
        for topic, kind, time_ns, data in _messages(source, size_px):
            if topic not in channels:
                schema = writer.register_schema(kind, "ros2msg", message_definition(kind).encode())
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            writer.add_message(channels[topic], time_ns, data, time_ns)
        writer.finish()  # type: ignore[no-untyped-call]


def _written_database(target: Path, source: Path, size_px: tuple[int, int] | None) -> None:
    topics = dict.fromkeys((topic, kind) for topic, kind, _time_ns, _data in _messages(source, (1, 1)))
    connection = sqlite3.connect(target, isolation_level=None)
    connection.executescript(TABLES)
    connection.execute("BEGIN")
    for number, (topic, kind) in enumerate(topics, 1):
        connection.execute("INSERT INTO topics VALUES (?, ?, ?, 'cdr', '')", (number, topic, kind))
        rows = ((number, time_ns, data) for name, _, time_ns, data in _messages(source, size_px) if name == topic)
        connection.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", rows)
    connection.execute("COMMIT")
    connection.close()
