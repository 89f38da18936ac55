"""Writes salvaged messages into a new chunked and indexed MCAP file.

**Conventions.** Schemas and channels get new ids in order of arrival, one for each content. If a channel is defined
twice with different content, its messages are left out from then on. Unwritable records are counted.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import BinaryIO

from mcap.writer import CompressionType, Writer

from stone_recordings.bags.chunks import CHUNK_LIMIT_BYTES
from stone_recordings.bags.errors import IngestError, MalformedBagError
from stone_recordings.bags.mcap import extras
from stone_recordings.bags.mcap import records as wire
from stone_recordings.bags.mcap.records import McapChannel
from stone_recordings.bags.mcap.salvage import Losses, SalvagedRecord
from stone_recordings.bags.message_store import Topic

COMPRESSIONS = {"": CompressionType.NONE, "lz4": CompressionType.LZ4, "zstd": CompressionType.ZSTD}
CHUNK_BYTES = 4 << 20
MOST_CHANNELS = 65_535
LIBRARY = "stone-recover"


class Copy:
    """Returned by `opened_copy`; call `keep` record after record."""

    def __init__(self, writer: Writer) -> None:
        self.topics: dict[str, int] = {}
        self.messages, self.first_ns, self.last_ns = 0, 0, 0
        self._writer = writer
        self._is_started = False
        self._known_schemas: dict[extras.SchemaBytes, int] = {}
        self._known_channels: dict[tuple[object, ...], int] = {}
        self.begin(Losses())

    def begin(self, losses: Losses, definitions: Mapping[tuple[int, int], SalvagedRecord] | None = None) -> None:
        """Start another file, whose ids are its own and whose losses are `losses`.

        `definitions` are schemas and channels by opcode and id, for messages whose own were not whole.
        """
        self.losses, self._spare = losses, definitions or {}
        self._schemas: dict[int, extras.SchemaBytes] = {}
        self._schema_ids = {0: 0}
        self._channels: dict[int, extras.ChannelWhole] = {}
        self._written: dict[int, tuple[int, str]] = {}
        self._unknown = 0

    def declare(self, topic: Topic) -> int:
        """Add a channel for a topic of a database; return its id for `write`."""
        schema_id = 0
        if topic.type:
            schema_id = self._registered_schema(extras.SchemaBytes(topic.type, "ros2msg", topic.schema.encode()))
        whole = extras.ChannelWhole(McapChannel(schema_id, topic.name, topic.encoding), {})
        return self._registered_channel(whole, schema_id)

    def write(self, channel_id: int, topic: str, message: extras.Message) -> None:
        """Write one message under a channel of the new file."""
        log_time_ns, data = message.log_time_ns, bytes(message.data)
        self._writer.add_message(channel_id, log_time_ns, data, message.publish_time_ns, message.sequence)
        self.first_ns = min(self.first_ns, log_time_ns) if self.messages else log_time_ns
        self.last_ns = max(self.last_ns, log_time_ns)
        self.messages += 1
        self.topics[topic] += 1

    def keep(self, found: SalvagedRecord) -> None:
        """Write one record; a record with contradictory lengths is added to the losses."""
        try:
            self._keep(found)
        except IngestError as error:
            self.losses.refuse(error)

    def say_unknown(self) -> None:
        if self._unknown:
            self.losses.add(f"{self._unknown} messages of channels that are not defined, or logged after the year 2262")

    def start(self, profile: str) -> None:
        """Start the file once; a file with a late or missing header has the profile of the first call."""
        if not self._is_started:
            self._writer.start(profile, library=LIBRARY)
            self._is_started = True

    def _keep(self, salvaged: SalvagedRecord) -> None:
        opcode, fields = salvaged.record.opcode, salvaged.fields()
        if opcode == wire.MESSAGE:
            self._message(extras.read_message(fields))
        elif opcode == wire.HEADER:
            self.start(extras.read_header(fields).profile)
        elif opcode == wire.SCHEMA:
            self._schema(*extras.read_schema_bytes(fields))
        elif opcode == wire.CHANNEL:
            self._channel(*extras.read_channel_whole(fields))
        elif opcode == extras.METADATA:
            metadata = extras.read_metadata(fields)
            self.start("")
            self._writer.add_metadata(metadata.name, metadata.values)
        elif opcode == extras.ATTACHMENT:
            self._attachment(salvaged)

    def _message(self, message: extras.Message) -> None:
        if message.channel_id not in self._channels:
            self._define_from_spare(message.channel_id)
        if message.channel_id not in self._written or message.log_time_ns > wire.LAST_LOG_TIME_NS:
            self._unknown += 1
            return
        self.write(*self._written[message.channel_id], message)

    def _define_from_spare(self, channel_id: int) -> None:
        channel = self._spare.get((wire.CHANNEL, channel_id))
        if channel is None:
            return
        schema = self._spare.get((wire.SCHEMA, extras.read_channel_whole(channel.fields())[1].channel.schema_id))
        for spare in (schema, channel):
            if spare is not None:
                self._keep(spare)

    def _schema(self, schema_id: int, schema: extras.SchemaBytes) -> None:
        if self._schemas.setdefault(schema_id, schema) != schema:
            self.losses.add(f"a second, different definition of schema {schema_id}")
        elif schema_id not in self._schema_ids:
            self._schema_ids[schema_id] = self._registered_schema(schema)

    def _channel(self, channel_id: int, whole: extras.ChannelWhole) -> None:
        schema_id = self._schema_ids.get(whole.channel.schema_id)
        if self._channels.setdefault(channel_id, whole) != whole:
            self.losses.add(f"messages after a second, different definition of channel {channel_id}")
            self._written.pop(channel_id, None)
        elif channel_id not in self._written and schema_id is not None:
            self._written[channel_id] = (self._registered_channel(whole, schema_id), whole.channel.topic)

    def _registered_schema(self, schema: extras.SchemaBytes) -> int:
        """Return the schema's id in the new file: one per content, whichever file it came from."""
        self.start("")
        if schema not in self._known_schemas:
            made = self._writer.register_schema(schema.name, schema.encoding, schema.data)
            self._known_schemas[schema] = made
        return self._known_schemas[schema]

    def _registered_channel(self, whole: extras.ChannelWhole, schema_id: int) -> int:
        self.start("")
        channel = whole.channel
        self.topics.setdefault(channel.topic, 0)
        key = (schema_id, channel.topic, channel.encoding, tuple(whole.metadata.items()))
        if key not in self._known_channels:
            if len(self._known_channels) == MOST_CHANNELS:
                raise MalformedBagError(channel.topic, f"an MCAP file has at most {MOST_CHANNELS} channels")
            made = self._writer.register_channel(channel.topic, channel.encoding, schema_id, whole.metadata)
            self._known_channels[key] = made
        return self._known_channels[key]

    def _attachment(self, salvaged: SalvagedRecord) -> None:
        if salvaged.record.stop - salvaged.record.start > CHUNK_LIMIT_BYTES:
            self.losses.add(f"an attachment of more than {CHUNK_LIMIT_BYTES} bytes")
            return
        kept = extras.read_attachment(salvaged.fields())
        self.start("")
        self._writer.add_attachment(kept.create_time_ns, kept.log_time_ns, kept.name, kept.media_type, kept.data)


@contextmanager
def opened_copy(stream: BinaryIO, compression: str) -> Iterator[Copy]:
    """Yield a copy that is complete, with summary and indexes, when the block ends."""
    packing = COMPRESSIONS.get(compression, CompressionType.ZSTD)
    writer = Writer(stream, chunk_size=CHUNK_BYTES, compression=packing)
    copy = Copy(writer)
    yield copy
    copy.start("")
    writer.finish()  # type: ignore[no-untyped-call]
