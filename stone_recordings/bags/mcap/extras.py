"""The MCAP records that readers of messages skip and a copy of the file must keep, field by field.

**Conventions.** As `mcap_records`: no length is trusted, and a value that overruns its record is a MalformedBagError.
Maps keep the order of the file; a duplicate key keeps its last value.
"""

import zlib
from dataclasses import dataclass

from stone_recordings.bags.errors import ChecksumError
from stone_recordings.bags.mcap.records import Fields, McapChannel

ATTACHMENT, METADATA = 9, 12


@dataclass(frozen=True)
class McapHeader:
    profile: str
    library: str


@dataclass(frozen=True)
class Attachment:
    log_time_ns: int
    create_time_ns: int
    name: str
    media_type: str
    data: bytes


@dataclass(frozen=True)
class Metadata:
    name: str
    values: dict[str, str]


@dataclass(frozen=True)
class SchemaBytes:
    """A schema with undecoded text, which need not be UTF-8."""

    name: str
    encoding: str
    data: bytes


@dataclass(frozen=True)
class ChannelWhole:
    """A channel with its metadata (ROS 2: `offered_qos_profiles`)."""

    channel: McapChannel
    metadata: dict[str, str]


@dataclass(frozen=True, slots=True)
class Message:
    channel_id: int
    sequence: int
    log_time_ns: int
    publish_time_ns: int
    data: memoryview


def read_header(fields: Fields) -> McapHeader:
    return McapHeader(fields.text(), fields.text())


def read_schema_bytes(fields: Fields) -> tuple[int, SchemaBytes]:
    schema_id, name, encoding = fields.u16(), fields.text(), fields.text()
    start, stop = fields.span(fields.u32())
    return schema_id, SchemaBytes(name, encoding, bytes(fields.view[start:stop]))


def read_channel_whole(fields: Fields) -> tuple[int, ChannelWhole]:
    channel_id = fields.u16()
    channel = McapChannel(fields.u16(), fields.text(), fields.text())
    return channel_id, ChannelWhole(channel, _read_map(fields))


def read_message(fields: Fields) -> Message:
    """Return a message; `data` is a view that is valid as long as the source of `fields`."""
    channel_id, sequence = fields.u16(), fields.u32()
    log_time_ns, publish_time_ns = fields.u64(), fields.u64()
    return Message(channel_id, sequence, log_time_ns, publish_time_ns, fields.view[fields.at : fields.stop])


def read_attachment(fields: Fields) -> Attachment:
    """Return an attachment. Raises ChecksumError if the bytes differ from a written checksum."""
    first = fields.at
    log_time_ns, create_time_ns, name, media_type = fields.u64(), fields.u64(), fields.text(), fields.text()
    start, stop = fields.span(fields.u64())
    declared = fields.u32()
    if declared and (computed := zlib.crc32(fields.view[first:stop])) != declared:
        raise ChecksumError(f"{fields.where}, attachment {name!r}", computed, declared)
    return Attachment(log_time_ns, create_time_ns, name, media_type, bytes(fields.view[start:stop]))


def read_metadata(fields: Fields) -> Metadata:
    return Metadata(fields.text(), _read_map(fields))


def _read_map(fields: Fields) -> dict[str, str]:
    size_bytes = fields.u32()
    start, stop = fields.span(size_bytes)
    fields.at, record_stop, fields.stop = start, fields.stop, stop
    values = {}
    while fields.at < stop:
        key = fields.text()
        values[key] = fields.text()
    fields.stop = record_stop
    return values
