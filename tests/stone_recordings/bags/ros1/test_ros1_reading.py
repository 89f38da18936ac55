"""A ROS 1 bag is read as the MCAP file that holds the same, however it was written and whether it was closed."""

from itertools import product
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag1 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from stone_recordings.bags.bag import Bag, open_bag
from stone_recordings.bags.message_store import HEAD_BYTES
from stone_recordings.report.inspection import inspect
from stone_recordings.report.inspection_record import inspection_record
from testing.worlds.ros1_bags import ROS1_COMPRESSIONS, Ros1Compression, as_ros1, unclosed

OF_ROS2 = ("std_msgs/msg/Header", "builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")


def _made(drive: Path, folder: Path, compression: Ros1Compression, is_closed: bool) -> Path:
    bag = as_ros1(drive, folder / "run.bag", compression, chunk_bytes=200_000)
    return bag if is_closed else unclosed(bag, folder / "run.bag.active")


def assert_same(found: Bag, expected: Bag) -> None:
    """Topics, log times, and every byte of every message."""
    kinds = [[(topic.name, topic.type, topic.count) for topic in bag.topics] for bag in (found, expected)]
    assert kinds[0] == kinds[1]
    for topic in expected.topics:
        assert np.array_equal(found.log_times_ns(topic.name), expected.log_times_ns(topic.name))
        for ours, theirs in zip(found.messages(topic.name), expected.messages(topic.name), strict=True):
            assert ours.payload == theirs.payload, topic.name


@pytest.mark.parametrize(("compression", "is_closed"), list(product(ROS1_COMPRESSIONS, (True, False))))
def test_every_byte_is_that_of_the_mcap_file_and_a_walk_finds_what_the_index_does(
    drive: Path, tmp_path: Path, compression: Ros1Compression, is_closed: bool
) -> None:
    with open_bag(_made(drive, tmp_path, compression, is_closed)) as bag, open_bag(drive) as expected:
        assert_same(bag, expected)
        assert bag.is_indexed == is_closed
        assert [finding.code for finding in bag.findings] == ([] if is_closed else ["BAG-010"])
        assert not bag.damaged


@pytest.mark.parametrize("compression", ROS1_COMPRESSIONS)
def test_a_head_is_the_beginning_of_its_message_and_its_size_is_known(
    drive: Path, tmp_path: Path, compression: Ros1Compression
) -> None:
    with open_bag(_made(drive, tmp_path, compression, is_closed=True)) as bag:
        names = [topic.name for topic in bag.topics]
        for name, index, head in bag.heads(names, whole=("/radar/front/detections",)):
            message = bag.message(name, index).payload
            assert message[: len(head)] == head
            assert len(head) >= min(len(message), HEAD_BYTES)
            if bag.size_bytes(name, index) != len(message):  # behind its head it has padding
                assert name.startswith("/radar/")
            assert name != "/radar/front/detections" or len(head) == len(message)


@pytest.mark.parametrize("compression", ROS1_COMPRESSIONS)
def test_an_inspection_says_what_it_says_of_the_mcap_file(
    drive: Path, tmp_path: Path, compression: Ros1Compression
) -> None:
    found = inspection_record(inspect(_made(drive, tmp_path, compression, is_closed=True)))
    assert found == inspection_record(inspect(drive))


def test_of_an_unclosed_bag_the_same_is_said_but_for_its_end(drive: Path, tmp_path: Path) -> None:
    found, expected = inspect(_made(drive, tmp_path, "lz4", is_closed=False)), inspect(drive)
    own = [finding.code for finding in found.findings if finding not in expected.findings]
    assert own == ["BAG-010", "BAG-011"]
    records = [{**inspection_record(one), "findings": [], "findings_total": 0} for one in (found, expected)]
    assert records[0] == records[1]


def test_a_split_bag_is_one_recording(drive: Path, tmp_path: Path) -> None:
    """As `rosbag record --split` names its files; the recorder died in the last one."""
    folder = tmp_path / "split"
    folder.mkdir()
    as_ros1(drive, folder / "run_0.bag", "lz4")
    unclosed(folder / "run_0.bag", folder / "run_1.bag.active")
    with open_bag(folder) as bag, open_bag(drive) as expected:
        counts = {topic.name: topic.count for topic in expected.topics}
        assert {topic.name: topic.count for topic in bag.topics} == {name: 2 * n for name, n in counts.items()}
        assert [finding.code for finding in bag.findings] == ["BAG-025", "BAG-010"]


def test_topics_of_the_old_tf_are_those_of_the_new(drive: Path, tmp_path: Path) -> None:
    content = as_ros1(drive, tmp_path / "run.bag").read_bytes()
    old = b"tf/tfMessage"
    path = tmp_path / "old.bag"
    path.write_bytes(_renamed(content, b"tf2_msgs/TFMessage", old))
    with open_bag(path) as bag:
        (topic,) = (topic for topic in bag.topics if topic.name == "/tf_static")
        assert topic.type == "tf2_msgs/msg/TFMessage"
        assert len(bag.message("/tf_static", 0).payload) > 100


def _renamed(content: bytes, type_name: bytes, other: bytes) -> bytes:
    """With another type in its connections, of the same length: what is too long goes into a field of no meaning."""
    field, filler = b"type=" + type_name, len(type_name) - len(other) - 4
    made = b"type=" + other + filler.to_bytes(4, "little") + b"x=" + bytes(filler - 2)
    size, shorter = len(field).to_bytes(4, "little"), len(b"type=" + other).to_bytes(4, "little")
    assert content.count(size + field) == 2
    return content.replace(size + field, shorter + made)


@pytest.mark.field_data
def test_of_a_real_bag_every_message_is_what_rosbags_makes_of_it(field_data: Path) -> None:
    """Recorded by ROS 1 itself, with types that only it describes."""
    [path] = (field_data / "ros1" / "sick").glob("*.bag")
    with Reader(path) as reader, open_bag(path) as bag:
        store, counts = _types_of(reader), dict.fromkeys((topic.name for topic in bag.topics), 0)
        for connection, time_ns, raw in reader.messages():
            found = bag.message(connection.topic, counts[connection.topic])
            counts[connection.topic] += 1
            assert found.log_time_ns == time_ns
            assert found.payload == store.ros1_to_cdr(raw, connection.msgtype)
        assert counts == {topic.name: topic.count for topic in bag.topics}
        assert sum(counts.values()) == reader.message_count


@pytest.mark.field_data
def test_of_a_real_bag_its_roles_are_known_and_nothing_else_is_said_than_of_an_mcap_file(field_data: Path) -> None:
    [path] = (field_data / "ros1" / "sick").glob("*.bag")
    inspection = inspect(path)
    roles = {part.topic.name: part.role for part in inspection.topics if part.topic.type.endswith("PointCloud2")}
    assert roles == {"/cloud": "lidar", "/cloud_radar_rawtarget": "radar", "/cloud_radar_track": "radar"}
    assert not {finding.code for finding in inspection.findings} & {"BAG-010", "BAG-012", "BAG-014", "BAG-020"}


def _types_of(reader: Reader) -> Typestore:
    """What the bag describes, its header as ROS 2 has it: rosbags drops `seq` where the type has none."""
    store, known = get_typestore(Stores.EMPTY), get_typestore(Stores.ROS2_HUMBLE).fielddefs
    store.register({name: known[name] for name in OF_ROS2})
    for connection in reader.connections:
        types = get_types_from_msg(connection.msgdef.data, connection.msgtype)
        store.register({name: told for name, told in types.items() if name not in store.fielddefs})
    return store
