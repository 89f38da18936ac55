"""All 416 official MCAP files say what the JSON beside them says.

Compared: through `McapStore` topics, schemas and messages in log order; through the walk and the readers of
`mcap_extras` (what a recovery copies) the header, schemas, channels with metadata, messages with sequence and publish
time, attachments and metadata records in the order of the file; through `mcap_records` statistics and chunk indexes;
through a recovery everything that the mcap library reads back. Not compared, as nothing reads them: the index records
of attachments and metadata, summary offsets, the checksum of the data section.
"""

import json
from collections import Counter
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import SeekingReader

from stone_recordings.bags.mcap import extras
from stone_recordings.bags.mcap import records as wire
from stone_recordings.bags.mcap.catalogue import read_catalogue
from stone_recordings.bags.mcap.copy import opened_copy
from stone_recordings.bags.mcap.records import Fields
from stone_recordings.bags.mcap.salvage import Losses, complete_records, first_compression
from stone_recordings.bags.mcap.store import McapStore

pytestmark = pytest.mark.field_data
COUNTS = {
    "NoData": 6, "OneAttachment": 14, "OneMessage": 154, "OneMetadata": 14, "OneSchemalessMessage": 74,
    "TenMessages": 154,
}  # fmt: skip
Said = tuple[str, dict[str, Any]]
DATA_RECORDS = ("Header", "Schema", "Channel", "Message", "Attachment", "Metadata")


def _said(path: Path) -> list[Said]:
    """The JSON's records: every number a string, bytes a list of such."""
    records = json.loads(path.with_suffix(".json").read_text())["records"]
    return [(record["type"], dict(record["fields"])) for record in records]


def _text(data: bytes | memoryview) -> list[str]:
    return [str(byte) for byte in bytes(data)]


def _schema(fields: Fields) -> Said:
    schema_id, schema = extras.read_schema_bytes(fields)
    return "Schema", {
        "data": _text(schema.data), "encoding": schema.encoding, "id": str(schema_id), "name": schema.name
    }  # fmt: skip


def _channel(fields: Fields) -> Said:
    channel_id, whole = extras.read_channel_whole(fields)
    channel = whole.channel
    return "Channel", {
        "id": str(channel_id), "message_encoding": channel.encoding, "metadata": whole.metadata,
        "schema_id": str(channel.schema_id), "topic": channel.topic,
    }  # fmt: skip


def _message(fields: Fields) -> Said:
    read = extras.read_message(fields)
    return "Message", {
        "channel_id": str(read.channel_id), "data": _text(read.data), "log_time": str(read.log_time_ns),
        "publish_time": str(read.publish_time_ns), "sequence": str(read.sequence),
    }  # fmt: skip


def _attachment(fields: Fields) -> Said:
    read = extras.read_attachment(fields)
    return "Attachment", {
        "create_time": str(read.create_time_ns), "data": _text(read.data), "log_time": str(read.log_time_ns),
        "media_type": read.media_type, "name": read.name,
    }  # fmt: skip


def _metadata(fields: Fields) -> Said:
    read = extras.read_metadata(fields)
    return "Metadata", {"metadata": read.values, "name": read.name}


def _header(fields: Fields) -> Said:
    read = extras.read_header(fields)
    return "Header", {"library": read.library, "profile": read.profile}


READERS: dict[int, Callable[[Fields], Said]] = {
    wire.HEADER: _header, wire.SCHEMA: _schema, wire.CHANNEL: _channel, wire.MESSAGE: _message,
    extras.ATTACHMENT: _attachment, extras.METADATA: _metadata,
}  # fmt: skip


def _walked(view: memoryview, name: str) -> list[Said]:
    losses = Losses()
    found = [(found.record.opcode, found.fields()) for found in complete_records(view, name, losses)]
    assert losses.is_sealed
    assert losses.problems == []
    return [READERS[opcode](fields) for opcode, fields in found if opcode in READERS]


def _check_records(path: Path, said: list[Said]) -> None:
    in_data = said[: [kind for kind, _fields in said].index("DataEnd")]
    assert _walked(memoryview(path.read_bytes()), path.name) == [each for each in in_data if each[0] in DATA_RECORDS]


def _check_store(path: Path, said: list[Said]) -> None:
    """Topics with their types, definitions and encodings, and messages by topic in log order, ties in file order."""
    store, schemas = McapStore(path), {"0": {"name": "", "data": []}}
    schemas |= {fields["id"]: fields for kind, fields in said if kind == "Schema"}
    channels = {fields["id"]: fields for kind, fields in said if kind == "Channel"}
    messages = [fields for kind, fields in said if kind == "Message"]
    counts = Counter(channels[message["channel_id"]]["topic"] for message in messages)
    assert {(topic.name, topic.type, topic.count, topic.encoding, topic.schema) for topic in store.topics} == {
        (
            channel["topic"],
            schemas[channel["schema_id"]]["name"],
            counts[channel["topic"]],
            channel["message_encoding"],
            bytes(map(int, schemas[channel["schema_id"]]["data"])).decode(),
        )
        for channel in channels.values()
    }
    for topic in store.topics:
        own = [message for message in messages if channels[message["channel_id"]]["topic"] == topic.name]
        in_order = sorted(own, key=lambda message: int(message["log_time"]))
        assert store.log_times_ns(topic.name).tolist() == [int(message["log_time"]) for message in in_order]
        assert [_text(store.payload(topic.name, index)) for index in range(topic.count)] == [
            message["data"] for message in in_order
        ]
    heads = [_text(payload) for _name, _index, payload in store.heads([topic.name for topic in store.topics])]
    assert heads == [message["data"] for message in messages]


def _check_summary(path: Path, said: list[Said]) -> None:
    """Statistics and chunk indexes as read, and the statistics as counted from what the catalogue holds."""
    view = memoryview(path.read_bytes())
    footer_offset = len(view) - len(wire.MAGIC) - 29
    start = Fields(view, wire.record_at(view, footer_offset, len(view), path.name), path.name).u64() or footer_offset
    records = [(record.opcode, Fields(view, record, path.name)) for record in wire.walk(view, start, footer_offset, "")]
    catalogue = read_catalogue(view, path.name)
    counted = {str(channel): str(len(entries.log_time_ns)) for channel, entries in catalogue.entries.items()}
    statistics = [fields for kind, fields in said if kind == "Statistics"]
    read = [wire.read_statistics(fields) for opcode, fields in records if opcode == wire.STATISTICS]
    assert [(str(each.message_count), str(each.chunk_count)) for each in read] == [
        (each["message_count"], each["chunk_count"]) for each in statistics
    ]
    for each in statistics:
        assert each["channel_message_counts"] == counted
        assert each["chunk_count"] == str(len(catalogue.chunks))
        assert each["message_count"] == str(sum(map(int, counted.values())))
        times = [int(time_ns) for entries in catalogue.entries.values() for time_ns in entries.log_time_ns]
        assert (each["message_start_time"], each["message_end_time"]) == (
            str(min(times, default=0)),
            str(max(times, default=0)),
        )
    indexes = [wire.read_chunk_index(fields) for opcode, fields in records if opcode == wire.CHUNK_INDEX]
    assert [
        (str(i.chunk_offset), {str(c): str(at) for c, at in i.message_index_offsets}, str(i.message_index_bytes))
        for i in indexes
    ] == [
        (fields["chunk_start_offset"], fields["message_index_offsets"], fields["message_index_length"])
        for kind, fields in said
        if kind == "ChunkIndex"
    ]


def _check_recovery(path: Path, said: list[Said]) -> None:
    view, stream, losses = memoryview(path.read_bytes()), BytesIO(), Losses()
    with opened_copy(stream, first_compression(view, path.name)) as copy:
        copy.begin(losses)
        for found in complete_records(view, path.name, losses):
            copy.keep(found)
    assert losses.problems == []
    reader = SeekingReader(BytesIO(stream.getvalue()))
    assert [
        (
            channel.topic,
            schema.name if schema else "",
            _text(message.data),
            str(message.log_time),
            str(message.sequence),
        )
        for schema, channel, message in reader.iter_messages(log_time_order=False)
    ] == [_message_said(fields, said) for kind, fields in said if kind == "Message"]
    assert [(kept.name, kept.media_type, _text(kept.data)) for kept in reader.iter_attachments()] == [
        (fields["name"], fields["media_type"], fields["data"]) for kind, fields in said if kind == "Attachment"
    ]
    assert [(kept.name, kept.metadata) for kept in reader.iter_metadata()] == [
        (fields["name"], fields["metadata"]) for kind, fields in said if kind == "Metadata"
    ]


def _message_said(fields: dict[str, Any], said: list[Said]) -> tuple[str, str, list[str], str, str]:
    channel = next(other for kind, other in said if kind == "Channel" and other["id"] == fields["channel_id"])
    names = [other["name"] for kind, other in said if kind == "Schema" and other["id"] == channel["schema_id"]]
    return channel["topic"], (*names, "")[0], fields["data"], fields["log_time"], fields["sequence"]


@pytest.mark.parametrize("folder", COUNTS)
def test_every_official_file_says_what_its_json_says(field_data, folder, monkeypatch):
    # Their messages are encoded as "a", which a recording of a robot would be refused for.
    monkeypatch.setattr(McapStore, "_refuse_other_encodings", lambda _store: None)
    paths = sorted((field_data / "mcap_conformance" / folder).glob("*.mcap"))
    assert len(paths) == COUNTS[folder]
    for path in paths:
        said = _said(path)
        _check_records(path, said)
        _check_store(path, said)
        _check_summary(path, said)
        _check_recovery(path, said)
