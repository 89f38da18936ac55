"""What `open_bag` gives back is what was written, however the container was put together."""

from itertools import product
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType, IndexType
from rosbags.rosbag2 import Reader

from stone_recordings.bags.bag import Bag, open_bag
from stone_recordings.bags.chunked_store import KEPT_CHUNKS
from stone_recordings.bags.errors import ChecksumError, EncodingRefusedError, MalformedBagError, UnknownTopicError
from tests.stone_recordings.writing import Recorded, write_mcap

IMU = "sensor_msgs/msg/Imu"
HEAD = b"\x00\x01\x00\x00"


def _messages(count: int = 40) -> list[Recorded]:
    """Two topics, log times out of order and with ties."""
    generator = np.random.default_rng(3)
    times = generator.integers(0, 12, count) * 1_000
    return [
        Recorded(f"/{'ab'[row % 2]}", IMU, int(times[row]), HEAD + generator.bytes(int(generator.integers(0, 300))))
        for row in range(count)
    ]


def _in_log_order(messages: list[Recorded], topic: str) -> list[tuple[int, bytes]]:
    """Stable, so that messages of one log time stay in the order of the file."""
    of_topic = [(message.log_time_ns, message.payload) for message in messages if message.topic == topic]
    return sorted(of_topic, key=lambda pair: pair[0])


def _read(bag: Bag, topic: str) -> list[tuple[int, bytes]]:
    return [(message.log_time_ns, bytes(message.payload)) for message in bag.messages(topic)]


CONTAINERS = [
    {"compression": compression, "chunk_size": 1000, "index_types": index, "use_chunking": chunked, **extra}
    for compression, index, chunked, extra in product(
        (CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD),
        (IndexType.ALL, IndexType.CHUNK, IndexType.NONE),
        (True, False),
        ({}, {"use_statistics": False}, {"repeat_channels": False, "repeat_schemas": False}),
    )
]


@pytest.mark.parametrize("options", CONTAINERS, ids=lambda options: "-".join(str(v) for v in options.values()))
def test_every_kind_of_container_gives_the_same_messages(tmp_path: Path, options: dict[str, object]) -> None:
    messages = _messages()
    with open_bag(write_mcap(tmp_path / "run.mcap", messages, **options)) as bag:
        assert [(topic.name, topic.type, topic.count) for topic in bag.topics] == [("/a", IMU, 20), ("/b", IMU, 20)]
        for topic in ("/a", "/b"):
            assert _read(bag, topic) == _in_log_order(messages, topic)
        assert (bag.start_ns, bag.end_ns) == (
            min(message.log_time_ns for message in messages),
            max(message.log_time_ns for message in messages),
        )


def test_an_indexed_file_is_not_walked_and_one_without_index_is(tmp_path: Path) -> None:
    with open_bag(write_mcap(tmp_path / "indexed.mcap", _messages())) as bag:
        assert bag.is_indexed
    with open_bag(write_mcap(tmp_path / "plain.mcap", _messages(), use_chunking=False)) as bag:
        assert not bag.is_indexed


def test_rosbags_reads_the_same(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "run.mcap", _messages(), compression=CompressionType.ZSTD, chunk_size=500)
    with Reader(path) as reader, open_bag(path) as bag:
        for topic in bag.topics:
            connections = [connection for connection in reader.connections if connection.topic == topic.name]
            theirs = [(time_ns, bytes(data)) for _connection, time_ns, data in reader.messages(connections)]
            assert sorted(_read(bag, topic.name)) == sorted(theirs)


def test_any_message_can_be_read_alone_and_any_range_in_order(tmp_path: Path) -> None:
    messages = _messages()
    expected = _in_log_order(messages, "/a")
    path = write_mcap(tmp_path / "run.mcap", messages, compression=CompressionType.LZ4, chunk_size=500)
    with open_bag(path) as bag:
        for index in (19, 0, 7, 7, 12):
            message = bag.message("/a", index)
            assert (message.log_time_ns, bytes(message.payload), message.index) == (*expected[index], index)
        assert [message.index for message in bag.messages("/a", 5, 9)] == [5, 6, 7, 8]
        assert list(bag.messages("/a", 30)) == []
        with pytest.raises(IndexError):
            bag.message("/a", 20)


def test_no_more_than_the_last_chunks_are_kept(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "run.mcap", _messages(), compression=CompressionType.LZ4, chunk_size=500)
    with open_bag(path) as bag:
        store = bag._store
        for _message in bag.messages("/a"):
            assert len(store._chunks) <= KEPT_CHUNKS  # type: ignore[attr-defined]


def test_a_payload_outlives_its_bag(tmp_path: Path) -> None:
    messages = _messages()
    for compression in (CompressionType.NONE, CompressionType.ZSTD):
        with open_bag(write_mcap(tmp_path / "run.mcap", messages, compression=compression)) as bag:
            payload = bag.message("/b", 3).payload
        assert bytes(payload) == _in_log_order(messages, "/b")[3][1]
        assert payload.readonly


def test_heads_come_once_per_message_in_storage_order(tmp_path: Path) -> None:
    messages = _messages()
    path = write_mcap(tmp_path / "run.mcap", messages, compression=CompressionType.LZ4, chunk_size=500)
    with open_bag(path) as bag:
        heads = [(name, index, bytes(payload)) for name, index, payload in bag.heads(("/a", "/b"))]
        assert [(name, payload) for name, _index, payload in heads] == [(m.topic, m.payload) for m in messages]
        assert {(name, index) for name, index, _payload in heads} == {(n, i) for n in ("/a", "/b") for i in range(20)}
        assert list(bag.heads(())) == []


def test_an_empty_recording_has_no_topics_and_no_duration(tmp_path: Path) -> None:
    with open_bag(write_mcap(tmp_path / "empty.mcap", [])) as bag:
        assert (bag.topics, bag.start_ns, bag.end_ns) == ((), 0, 0)


def test_a_topic_that_was_not_recorded_is_named_beside_those_that_were(tmp_path: Path) -> None:
    with (
        open_bag(write_mcap(tmp_path / "run.mcap", _messages())) as bag,
        pytest.raises(UnknownTopicError, match=r"no topic '/lidar'; it has /a, /b"),
    ):
        next(bag.messages("/lidar"))


def test_a_recording_that_holds_no_cdr_is_refused(tmp_path: Path) -> None:
    with pytest.raises(EncodingRefusedError, match=r"'/a' is encoded as 'ros1', only 'cdr'"):
        open_bag(write_mcap(tmp_path / "ros1.mcap", _messages(), encoding="ros1"))


def test_a_damaged_chunk_is_found_by_its_checksum_whatever_its_compression(tmp_path: Path) -> None:
    for compression in CompressionType:
        path = write_mcap(tmp_path / "run.mcap", _messages(), compression=compression)
        content = bytearray(path.read_bytes())
        content[300] ^= 0x10
        path.write_bytes(content)
        with open_bag(path) as bag, pytest.raises((ChecksumError, MalformedBagError), match=r"chunk at byte \d+"):
            list(bag.messages("/a"))


def test_a_topic_of_two_types_is_refused(tmp_path: Path) -> None:
    path = write_mcap(
        tmp_path / "run.mcap", [Recorded("/a", IMU, 0, HEAD), Recorded("/b", "nav_msgs/msg/Odometry", 1, HEAD)]
    )
    path.write_bytes(path.read_bytes().replace(b"\x02\x00\x00\x00/b", b"\x02\x00\x00\x00/a"))
    with pytest.raises((MalformedBagError, ChecksumError)):
        open_bag(path)
