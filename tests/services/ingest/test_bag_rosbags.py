"""The slow path gives what the fast one gives, and refuses in our words."""

from pathlib import Path

import pytest
from rosbags.rosbag2 import StoragePlugin, Writer

from services.ingest.bag import open_bag
from services.ingest.errors import SlowPathRefusedError
from services.ingest.inspection import inspect
from services.ingest.mcap_store import McapStore
from services.ingest.messages.registry import typestore
from services.ingest.rosbags_store import RosbagsStore
from tests.services.ingest.writing import HESAI, POINT_CLOUD, Recorded, cloud_payload, sweep

MESSAGES = [
    Recorded(topic, POINT_CLOUD, time_ns, cloud_payload(sweep(HESAI, 10 + time_ns)))
    for topic in ("/left", "/right")
    for time_ns in (1, 2, 2, 5, 9)
]


def _written(folder: Path, plugin: StoragePlugin) -> Path:
    with Writer(folder, version=9, storage_plugin=plugin) as writer:
        connections = {
            topic: writer.add_connection(topic, POINT_CLOUD, typestore=typestore()) for topic in ("/left", "/right")
        }
        for message in MESSAGES:
            writer.write(connections[message.topic], message.log_time_ns, message.payload)
    return folder


@pytest.fixture(scope="module")
def database(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return _written(tmp_path_factory.mktemp("db3") / "run", StoragePlugin.SQLITE3)


def _payloads(topic: str) -> list[bytes]:
    return [message.payload for message in MESSAGES if message.topic == topic]


@pytest.mark.parametrize("is_folder", [True, False])
def test_a_database_and_its_folder_give_every_message_in_order(database: Path, is_folder: bool) -> None:
    with open_bag(database if is_folder else next(database.glob("*.db3"))) as bag:
        assert isinstance(bag._store, RosbagsStore)
        assert [(topic.name, topic.type, topic.count) for topic in bag.topics] == [
            ("/left", POINT_CLOUD, 5),
            ("/right", POINT_CLOUD, 5),
        ]
        assert (bag.start_ns, bag.end_ns) == (1, 9)
        for topic in ("/left", "/right"):
            assert [message.log_time_ns for message in bag.messages(topic)] == [1, 2, 2, 5, 9]
            assert [bytes(message.payload) for message in bag.messages(topic)] == _payloads(topic)


def test_any_message_of_a_database_can_be_read_alone(database: Path) -> None:
    with open_bag(database) as bag:
        for index in (4, 0, 2, 1, 2, 3):
            assert bytes(bag.message("/right", index).payload) == _payloads("/right")[index]
        assert [bytes(message.payload) for message in bag.messages("/left", 1, 3)] == _payloads("/left")[1:3]


def test_a_folder_of_one_mcap_file_takes_the_fast_path(tmp_path: Path, database: Path) -> None:
    with open_bag(_written(tmp_path / "run", StoragePlugin.MCAP)) as bag:
        assert isinstance(bag._store, McapStore)
        assert [bytes(message.payload) for message in bag.messages("/left")] == _payloads("/left")


def test_an_inspection_does_not_depend_on_the_container(tmp_path: Path, database: Path) -> None:
    mcap = _written(tmp_path / "run", StoragePlugin.MCAP)
    assert inspect(mcap).as_record() == inspect(database).as_record()


def test_a_damaged_database_or_metadata_is_one_coded_refusal(tmp_path: Path, database: Path) -> None:
    broken = tmp_path / "broken.db3"
    broken.write_bytes(next(database.glob("*.db3")).read_bytes()[:3000])
    with pytest.raises(SlowPathRefusedError, match=r"broken\.db3 cannot be read by rosbags") as caught:
        open_bag(broken)
    assert caught.value.code == "BAG-018"
    folder = tmp_path / "folder"
    folder.mkdir()
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information: [")
    with pytest.raises(SlowPathRefusedError, match="Could not load YAML"):
        open_bag(folder)


@pytest.mark.field_data
def test_a_database_without_definitions_is_read(field_data: Path) -> None:
    paths = sorted((field_data / "nebula_packets").rglob("*.db3"))
    assert paths
    for path in paths:
        with open_bag(path) as bag:
            assert sum(len(list(bag.messages(topic.name))) for topic in bag.topics) > 0
