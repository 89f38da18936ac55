"""A ROS 1 bag is read as the MCAP file that holds the same, however it was written and whether it was closed."""

from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag1 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from simulator.options import SimulateOptions
from simulator.pipeline import simulate
from stone_recordings.bags.bag import Bag, open_bag
from stone_recordings.bags.errors import CutBagError, MalformedBagError
from stone_recordings.bags.message_store import HEAD_BYTES
from stone_recordings.bags.recovery.recovery import recover
from stone_recordings.report.inspection import inspect, inspection_record
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


@pytest.mark.whole
@pytest.mark.parametrize(("compression", "is_closed"), [("none", True), ("bz2", False), ("lz4", True), ("lz4", False)])
def test_every_byte_is_that_of_the_mcap_file_and_a_walk_finds_what_the_index_does(
    drive: Path, tmp_path: Path, compression: Ros1Compression, is_closed: bool
) -> None:
    with open_bag(_made(drive, tmp_path, compression, is_closed)) as bag, open_bag(drive) as expected:
        assert_same(bag, expected)
        assert bag.is_indexed == is_closed
        assert [finding.code for finding in bag.findings] == ([] if is_closed else ["BAG-010"])
        assert not bag.damaged


@pytest.mark.whole
@pytest.mark.parametrize("compression", ROS1_COMPRESSIONS)
def test_a_head_is_the_beginning_of_its_message_and_its_size_is_known(drive, tmp_path, compression):
    with open_bag(_made(drive, tmp_path, compression, is_closed=True)) as bag:
        names = [topic.name for topic in bag.topics]
        for name, index, head in bag.heads(names, whole=("/radar/front/detections",)):
            message = bag.message(name, index).payload
            assert message[: len(head)] == head
            assert len(head) >= min(len(message), HEAD_BYTES)
            if bag.size_bytes(name, index) != len(message):  # behind its head it has padding
                assert name.startswith("/radar/")
            assert name != "/radar/front/detections" or len(head) == len(message)


@pytest.mark.whole
@pytest.mark.parametrize("compression", ["none", "lz4"])
def test_an_inspection_says_what_it_says_of_the_mcap_file(drive, tmp_path, compression):
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


CHUNK_BYTES = 100_000


def _messages(path: Path) -> dict[str, list[bytes]]:
    with open_bag(path) as bag:
        return {topic.name: [bytes(m.payload) for m in bag.messages(topic.name)] for topic in bag.topics if topic.count}


def test_a_whole_bag_becomes_the_mcap_file_that_it_was_made_of(drive: Path, tmp_path: Path) -> None:
    bag = as_ros1(drive, tmp_path / "run.bag", "lz4")
    recovery = recover(bag, tmp_path / "out.mcap")
    assert (recovery.finding.severity, recovery.lost) == ("info", "Only the index is lost.")
    assert _messages(tmp_path / "out.mcap") == _messages(drive)
    with open_bag(tmp_path / "out.mcap") as found, open_bag(bag) as expected:
        assert found.topics == expected.topics


@pytest.mark.whole
@pytest.mark.parametrize(("compression", "is_closed"), [("none", True), ("none", False), ("lz4", True), ("bz2", False)])
def test_a_bag_cut_anywhere_keeps_a_prefix_of_its_messages(drive, tmp_path, compression, is_closed):
    """Both as it is opened and as it is recovered; a closed bag that was cut by copying, too.

    Catches alone a message that is taken from a chunk which ends in the middle of it.
    """
    whole, expected = as_ros1(drive, tmp_path / "whole.bag", compression, CHUNK_BYTES), _messages(drive)
    content = (whole if is_closed else unclosed(whole, tmp_path / "open.bag")).read_bytes()
    cut, kept_before = tmp_path / "cut.bag", 0
    for size in range(150_000, len(content), len(content) // 4):
        cut.write_bytes(content[:size])
        kept = _messages(cut)
        for topic, payloads in kept.items():
            assert payloads == expected[topic][: len(payloads)]
        count = sum(len(payloads) for payloads in kept.values())
        assert count >= kept_before
        kept_before = count
        recovery = recover(cut, tmp_path / "out.mcap")
        assert recovery.finding.severity == ("info" if kept == expected and is_closed else "warning")
        assert recovery.read_bytes <= recovery.total_bytes == size
        assert _messages(tmp_path / "out.mcap") == kept
    assert kept_before > sum(map(len, expected.values())) // 2


def test_of_a_plain_chunk_that_the_recorder_died_in_every_whole_message_is_kept(drive: Path, tmp_path: Path) -> None:
    content = unclosed(as_ros1(drive, tmp_path / "whole.bag", chunk_bytes=1 << 30), tmp_path / "open.bag").read_bytes()
    cut = tmp_path / "cut.bag"
    cut.write_bytes(content[: len(content) // 2])
    with open_bag(cut) as bag, open_bag(drive) as whole:
        counts = [sum(topic.count for topic in one.topics) for one in (bag, whole)]
        assert counts[0] > 0.3 * counts[1]
        (finding,) = bag.findings
        assert (finding.code, finding.severity) == ("BAG-010", "warning")
        assert f"{counts[0]} messages up to byte" in finding.message


def test_a_chunk_that_does_not_inflate_costs_its_own_messages_and_is_said(drive: Path, tmp_path: Path) -> None:
    bag = as_ros1(drive, tmp_path / "run.bag", "lz4", CHUNK_BYTES)
    content = bytearray(bag.read_bytes())
    at = content.index(b"compression=lz4", len(content) // 2) + 2_000
    content[at : at + 64] = bytes(64)
    bag.write_bytes(content)
    with open_bag(bag) as opened:
        assert opened.is_indexed
        damaged = sum(len(reasons) for reasons in opened.damaged.values())
        assert {finding.code for finding in opened.damage_findings} == {"BAG-016"}
    recovery = recover(bag, tmp_path / "out.mcap")
    with open_bag(drive) as whole:
        assert recovery.messages == sum(topic.count for topic in whole.topics) - damaged
    assert damaged > 0


def test_a_record_that_is_none_is_passed_over_to_the_next_chunk_that_the_index_knows(drive, tmp_path):
    bag = as_ros1(drive, tmp_path / "run.bag", "lz4", CHUNK_BYTES)
    content = bytearray(bag.read_bytes())
    at = content.index(b"compression=lz4", len(content) // 2)
    content[at : at + 11] = b"COMPRESSION"
    content[at - 20 : at - 4] = bytes(16)
    bag.write_bytes(content)
    with pytest.raises(MalformedBagError):
        open_bag(bag)
    recovery = recover(bag, tmp_path / "out.mcap")
    with open_bag(drive) as whole:
        assert 0.5 < recovery.messages / sum(topic.count for topic in whole.topics) < 1


def test_a_bag_without_a_whole_message_is_refused(drive: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.bag"
    cut.write_bytes(as_ros1(drive, tmp_path / "run.bag").read_bytes()[:4_200])
    with pytest.raises(CutBagError):
        recover(cut, tmp_path / "out.mcap")


@pytest.fixture(scope="package")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All topics of the rig: clouds, pictures, radars, INS, IMU, static transforms. Read only."""
    bag = tmp_path_factory.mktemp("drive") / "run.mcap"
    simulate(bag, SimulateOptions(seconds=0.6, channels=16, columns=120, camera_width_px=48, world_width_m=30.0))
    return bag
