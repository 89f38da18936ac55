"""A recording of ours in the form of ROS 1, by `rosbags`: its bytes, its types, its bags.

**Conventions.** Types have the names and fields of ROS 1 Noetic if they exist there; a header's `seq` is 0. A bag is
`unclosed` if its recorder died: it has no index, and its header mentions none.
"""

from functools import cache
from pathlib import Path
from typing import Literal

from mcap.reader import make_reader
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from stone_recordings.messages.types.registry import typestore

Ros1Compression = Literal["none", "bz2", "lz4"]
ROS1_COMPRESSIONS: tuple[Ros1Compression, ...] = ("none", "bz2", "lz4")
HEAD_BYTES = 4096
FORMATS = {"bz2": Writer.CompressionFormat.BZ2, "lz4": Writer.CompressionFormat.LZ4}


def as_ros1(source: Path, target: Path, compression: Ros1Compression = "none", chunk_bytes: int = 1 << 20) -> Path:
    """Write `target`, an indexed bag of every message of an MCAP file, in the order of its log."""
    writer = Writer(target)
    writer.chunk_threshold = chunk_bytes
    if compression != "none":
        writer.set_compression(FORMATS[compression])
    with source.open("rb") as stream, writer:
        connections = {}
        for schema, channel, message in make_reader(stream).iter_messages():
            assert schema is not None
            if channel.id not in connections:
                definition = ros1_types().generate_msgdef(schema.name, ros_version=1)
                connections[channel.id] = writer.add_connection(
                    channel.topic,
                    schema.name,
                    msgdef=definition[0],
                    md5sum=definition[1],
                    callerid="/recorder",
                    latching=0,
                )
            data = typestore().cdr_to_ros1(message.data, schema.name)
            writer.write(connections[channel.id], message.log_time, data)
    return target


def unclosed(bag: Path, target: Path) -> Path:
    """Write a closed bag as it was before its recorder wrote the index."""
    content = bytearray(bag.read_bytes())
    at = content.index(b"index_pos=", 0, HEAD_BYTES) + len(b"index_pos=")
    index_at = int.from_bytes(content[at : at + 8], "little")
    content[at : at + 8] = bytes(8)
    for name in (b"conn_count=", b"chunk_count="):
        begin = content.index(name, 0, HEAD_BYTES) + len(name)
        content[begin : begin + 4] = bytes(4)
    target.write_bytes(content[:index_at])
    return target


@cache
def ros1_types() -> Typestore:
    """Return the definitions of ROS 1: Noetic's, and our types that it lacks."""
    store = get_typestore(Stores.EMPTY)
    store.register({**typestore().fielddefs, **get_typestore(Stores.ROS1_NOETIC).fielddefs})
    return store
