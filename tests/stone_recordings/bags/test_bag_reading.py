"""What `open_bag` gives back is what was written, whatever the container, and what rosbags gives."""

import sqlite3
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType, IndexType
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer

from stone_recordings.bags import errors
from stone_recordings.bags.bag import Bag, open_bag
from stone_recordings.bags.db3.store import SqliteStore
from stone_recordings.bags.mcap.store import McapStore
from stone_recordings.bags.message_store import HEAD_BYTES
from stone_recordings.messages.types.registry import message_definition, typestore
from stone_recordings.report.inspection import inspect
from testing.refusals import refused_as
from tests.stone_recordings.databases import SCHEMAS, write_db3
from tests.stone_recordings.writing import HESAI, POINT_CLOUD, Recorded, cloud_payload, sweep, write_mcap

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


def test_any_message_can_be_read_alone_and_outlives_its_bag(tmp_path: Path) -> None:
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
    for compression in (CompressionType.NONE, CompressionType.ZSTD):
        with open_bag(write_mcap(tmp_path / "run.mcap", messages, compression=compression)) as bag:
            payload = bag.message("/b", 3).payload
        assert bytes(payload) == _in_log_order(messages, "/b")[3][1]
        assert payload.readonly


def test_a_topic_that_was_not_recorded_or_is_no_cdr_is_refused_and_none_has_no_duration(tmp_path: Path) -> None:
    with open_bag(write_mcap(tmp_path / "empty.mcap", [])) as bag:
        assert (bag.topics, bag.start_ns, bag.end_ns) == ((), 0, 0)
    with open_bag(write_mcap(tmp_path / "run.mcap", _messages())) as bag, refused_as("BAG-015"):
        next(bag.messages("/lidar"))
    with refused_as("BAG-014"):
        open_bag(write_mcap(tmp_path / "ros1.mcap", _messages(), encoding="ros1"))


def test_a_topic_of_two_types_is_refused(tmp_path: Path) -> None:
    path = write_mcap(
        tmp_path / "run.mcap", [Recorded("/a", IMU, 0, HEAD), Recorded("/b", "nav_msgs/msg/Odometry", 1, HEAD)]
    )
    path.write_bytes(path.read_bytes().replace(b"\x02\x00\x00\x00/b", b"\x02\x00\x00\x00/a"))
    with pytest.raises((errors.MalformedBagError, errors.ChecksumError)):
        open_bag(path)


MESSAGES = [
    Recorded(topic, POINT_CLOUD, time_ns, cloud_payload(sweep(HESAI, 10 + 400 * time_ns)))
    for topic in ("/left", "/right")
    for time_ns in (5, 2, 1, 2, 9)
]


def _written(folder: Path, plugin: StoragePlugin, mode: CompressionMode = CompressionMode.NONE) -> Path:
    writer = Writer(folder, version=9, storage_plugin=plugin)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connections = {
            topic: writer.add_connection(topic, POINT_CLOUD, typestore=typestore()) for topic in ("/left", "/right")
        }
        for message in MESSAGES:
            writer.write(connections[message.topic], message.log_time_ns, message.payload)
    return folder


@pytest.fixture(scope="module")
def database(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return _written(tmp_path_factory.mktemp("db3") / "run", StoragePlugin.SQLITE3)


def _expected(topic: str) -> list[tuple[int, bytes]]:
    own = [(message.log_time_ns, message.payload) for message in MESSAGES if message.topic == topic]
    return sorted(own, key=lambda pair: pair[0])


def _check_whole(bag: Bag) -> None:
    assert [(topic.name, topic.type, topic.count) for topic in bag.topics] == [
        ("/left", POINT_CLOUD, 5),
        ("/right", POINT_CLOUD, 5),
    ]
    assert (bag.start_ns, bag.end_ns) == (1, 9)
    for topic in ("/left", "/right"):
        assert _read(bag, topic) == _expected(topic)


@pytest.mark.parametrize("is_folder", [True, False])
def test_a_database_and_its_folder_give_every_message_in_order(database: Path, is_folder: bool) -> None:
    with open_bag(database if is_folder else next(database.glob("*.db3"))) as bag:
        assert isinstance(bag._store, SqliteStore)
        assert bag.findings == ()
        _check_whole(bag)


def test_rosbags_reads_the_same_and_the_same_definitions(database: Path) -> None:
    with Reader(database) as reader, open_bag(database) as bag:
        for topic in bag.topics:
            connections = [connection for connection in reader.connections if connection.topic == topic.name]
            theirs = [(time_ns, bytes(data)) for _connection, time_ns, data in reader.messages(connections)]
            assert sorted(_read(bag, topic.name)) == sorted(theirs)
            assert topic.schema == str(connections[0].msgdef.data) == message_definition(POINT_CLOUD)


@pytest.mark.parametrize("version", SCHEMAS)
def test_every_schema_version_is_read_and_only_the_fourth_embeds_definitions(tmp_path: Path, version: int) -> None:
    with open_bag(write_db3(tmp_path / "run.db3", MESSAGES, version=version)) as bag:
        _check_whole(bag)
        assert {topic.schema for topic in bag.topics} == {message_definition(POINT_CLOUD) if version == 4 else ""}
    with Reader(tmp_path / "run.db3") as reader:
        assert reader.message_count == len(MESSAGES)


@pytest.mark.parametrize("mode", [CompressionMode.MESSAGE, CompressionMode.FILE])
@pytest.mark.parametrize("plugin", StoragePlugin)
@pytest.mark.parametrize("has_metadata", [True, False])
def test_what_the_recorder_compressed_is_unpacked(tmp_path, mode, plugin, has_metadata):
    folder = _written(tmp_path / "run", plugin, mode)
    if not has_metadata:
        (folder / "metadata.yaml").unlink()
    before = {file.name: file.read_bytes() for file in folder.iterdir()}
    with open_bag(folder) as bag:
        _check_whole(bag)
        for name, index, head in bag.heads(("/left", "/right")):
            assert len(head) >= min(HEAD_BYTES, len(_expected(name)[index][1]))
            assert _expected(name)[index][1].startswith(bytes(head))
    assert {file.name: file.read_bytes() for file in folder.iterdir()} == before


def test_the_folder_for_unpacking_goes_with_the_bag(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = _written(tmp_path / "run", StoragePlugin.SQLITE3, CompressionMode.FILE)
    (tmp_path / "own").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "own"))
    with open_bag(folder) as bag:
        assert len(list((tmp_path / "own").iterdir())) == 1
        _check_whole(bag)
    del bag
    assert list((tmp_path / "own").iterdir()) == []


def test_heads_come_once_per_message_cut_unless_asked_whole(database: Path) -> None:
    with open_bag(database) as bag:
        heads = [(name, index, bytes(payload)) for name, index, payload in bag.heads(("/left", "/right"), {"/right"})]
    assert {(name, index) for name, index, _head in heads} == {(n, i) for n in ("/left", "/right") for i in range(5)}
    for name, index, head in heads:
        whole = _expected(name)[index][1]
        assert head == (whole if name == "/right" or len(whole) <= HEAD_BYTES else whole[:HEAD_BYTES])
    assert any(len(payload) > HEAD_BYTES for _time_ns, payload in _expected("/left"))


def test_a_folder_of_one_mcap_file_takes_the_fast_path(tmp_path: Path) -> None:
    with open_bag(_written(tmp_path / "run", StoragePlugin.MCAP)) as bag:
        assert isinstance(bag._store, McapStore)
        _check_whole(bag)


def test_an_inspection_does_not_depend_on_the_container(tmp_path: Path, database: Path) -> None:
    mcap = _written(tmp_path / "run", StoragePlugin.MCAP)
    assert inspect(mcap).as_record() == inspect(database).as_record()


def test_a_database_that_holds_no_cdr_or_is_another_program_s_is_refused(tmp_path: Path) -> None:
    path = write_db3(tmp_path / "run.db3", MESSAGES, encoding="protobuf")
    with refused_as("BAG-014"):
        open_bag(path)
    path = tmp_path / "history.db3"
    with sqlite3.connect(path) as connection:
        connection.execute("CREATE TABLE urls(id INTEGER PRIMARY KEY, url TEXT)")
    connection.close()
    with refused_as("BAG-018"):
        open_bag(path)


def test_a_topic_of_two_types_is_refused_and_of_two_ids_is_one(tmp_path: Path) -> None:
    path = write_db3(tmp_path / "run.db3", MESSAGES)
    with sqlite3.connect(path) as connection:
        connection.execute("UPDATE topics SET name = '/left'")
    connection.close()
    with open_bag(path) as bag:
        assert [(topic.name, topic.count) for topic in bag.topics] == [("/left", 10)]
        times = [message.log_time_ns for message in bag.messages("/left")]
        assert times == sorted(message.log_time_ns for message in MESSAGES)
    with sqlite3.connect(path) as connection:
        connection.execute("UPDATE topics SET type = 'sensor_msgs/msg/Imu' WHERE id = 2")
    connection.close()
    with pytest.raises(errors.MalformedBagError):
        open_bag(path)


def test_rows_that_are_no_messages_are_left_out_and_counted(tmp_path: Path) -> None:
    path = write_db3(tmp_path / "run.db3", MESSAGES)
    with sqlite3.connect(path) as connection:
        for row in ((1, "noon", b"x"), (77, 5, b"x"), (1, 5, "text"), (1, -5, b"x")):
            connection.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", row)
    connection.close()
    with open_bag(path) as bag:
        _check_whole(bag)
        assert [(finding.code, finding.severity) for finding in bag.findings] == [("BAG-031", "warning")]
        assert bag.findings[0].message.startswith("4 rows of run.db3")


def test_a_database_is_scanned_without_reading_its_clouds(tmp_path: Path) -> None:
    """The pages that are touched, counted by the bytes that the process reads."""
    clouds = [Recorded("/lidar", POINT_CLOUD, row, cloud_payload(sweep(HESAI, 100_000, seed=row))) for row in range(40)]
    path = write_db3(tmp_path / "run.db3", clouds)
    with open_bag(path) as bag:
        before = _read_bytes()
        for _name, _index, head in bag.heads(("/lidar",)):
            assert len(head) == HEAD_BYTES
        assert _read_bytes() - before < 0.05 * path.stat().st_size


def _read_bytes() -> int:
    """Bytes that this process asked the kernel for."""
    fields = dict(line.split(": ") for line in Path("/proc/self/io").read_text().splitlines())
    return int(fields["rchar"])


@pytest.mark.field_data
def test_a_recorded_database_without_definitions_equals_rosbags(field_data: Path) -> None:
    paths = sorted((field_data / "nebula_packets").rglob("*.db3"))
    assert paths
    for path in paths:
        with open_bag(path) as bag, Reader(path) as reader:
            theirs = sorted((time_ns, bytes(data)) for _connection, time_ns, data in reader.messages())
            ours = sorted(pair for topic in bag.topics for pair in _read(bag, topic.name))
            assert ours == theirs
            assert np.all([topic.schema == "" for topic in bag.topics])
