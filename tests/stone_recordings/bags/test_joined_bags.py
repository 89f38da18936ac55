"""Several bags opened as one: what each message says is what it said in the recording that was taken apart."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from simulator.options import SimulateOptions
from simulator.pipeline import simulate
from stone_files.bag_fingerprint import bag_paths, recording_inputs, recording_sha256
from stone_files.joined_file import GIVEN, JOINED, REFERENCE, SAME_TOPICS, JoinedFileError, JoinedMember, joined_bytes
from stone_recordings.bags.bag import Bag, open_bag
from stone_recordings.bags.errors import NotABagError
from stone_recordings.bags.joined.joined_store import moved, stamp_places
from stone_recordings.bags.message_store import Topic
from stone_recordings.bags.recovery.recovery import recover
from stone_recordings.joining.joined_recording import JoinedRecording, write_joined
from stone_recordings.sync.sweeps import opened
from testing.refusals import refused_as
from testing.worlds.recording_parts import RecordingPart, split_into
from tests.stone_recordings.writing import Recorded, write_mcap

AHEAD_NS = 80_000_000
Holds = Callable[[str, int], bool]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    bag = tmp_path_factory.mktemp("run") / "run.mcap"
    simulate(bag, SimulateOptions(seconds=1.0, channels=2, columns=60, cameras=False))
    return bag


def of(*words: str) -> Holds:
    return lambda topic, _time: any(word in topic for word in words)


def joined(folder: Path, source: Path, *parts: RecordingPart, **members: JoinedMember) -> Path:
    """The recording's parts, each moved back; `members` say otherwise by stem."""
    (folder / "parts").mkdir()
    (folder / "run").mkdir()
    paths = split_into(source, folder / "parts", parts)
    said = [
        members.get(path.stem, JoinedMember(path.name, -part.ahead_ns, None, (GIVEN if number else REFERENCE,)))
        for number, (path, part) in enumerate(zip(paths, parts, strict=True))
    ]
    write_joined(JoinedRecording(paths, tuple(said)), folder / "run")
    return folder / "run"


def told(bag: Bag) -> dict[str, list[tuple[int, bytes]]]:
    return {topic.name: [(m.log_time_ns, bytes(m.payload)) for m in bag.messages(topic.name)] for topic in bag.topics}


@pytest.fixture
def three(run: Path, tmp_path: Path) -> Path:
    """LiDAR and INS here, radar in a ROS 1 bag, the IMU in a third."""
    return joined(
        tmp_path,
        run,
        RecordingPart("run.mcap", of("lidar", "novatel", "tf")),
        RecordingPart("radars.bag", of("radar"), -AHEAD_NS),
        RecordingPart("imu.mcap", of("imu"), AHEAD_NS),
    )


def test_three_files_are_the_recording_that_was_taken_apart(run: Path, three: Path) -> None:
    with open_bag(run) as whole, open_bag(three) as bag:
        assert told(bag) == told(whole)
        names = [topic.name for topic in whole.topics]
        heads = [{(topic, at): bytes(head) for topic, at, head in one.heads(names, names)} for one in (whole, bag)]
        assert heads[0] == heads[1]
        assert bag.size_bytes(names[0], 0) == whole.size_bytes(names[0], 0)
        assert (bag.start_ns, bag.end_ns, bag.is_indexed) == (whole.start_ns, whole.end_ns, True)


def test_each_recording_is_named_with_its_offset_and_among_the_inputs(three: Path) -> None:
    with open_bag(three) as bag:
        assert [(one.name, one.offset_ns) for one in bag.recordings] == [
            ("run.mcap", 0), ("radars.bag", AHEAD_NS), ("imu.mcap", -AHEAD_NS)
        ]  # fmt: skip
        assert [(one.code, one.topic) for one in bag.findings] == [("SYN-521", "radars.bag"), ("SYN-521", "imu.mcap")]
    inputs = recording_inputs(three)
    assert set(inputs) == {"run.mcap", "radars.bag", "imu.mcap", JOINED}
    assert inputs["imu.mcap"] == recording_sha256((three / "imu.mcap").resolve())
    assert inputs[JOINED] == recording_sha256(three)
    assert set(bag_paths(three)) == {three, *(three / name for name in inputs)}


def test_a_recording_that_was_joined_anew_is_opened_anew(three: Path) -> None:
    assert len(opened(three).recordings) == 3
    (three / "made").write_bytes(joined_bytes([JoinedMember("run.mcap")]))
    (three / "made").replace(three / JOINED)
    assert len(opened(three).recordings) == 1


def test_a_run_that_was_cut_is_whole_again(run: Path, tmp_path: Path) -> None:
    with open_bag(run) as whole:
        middle_ns = (whole.start_ns + whole.end_ns) // 2
        expected = told(whole)
    folder = joined(
        tmp_path,
        run,
        RecordingPart("one.mcap", lambda _topic, time: time < middle_ns),
        RecordingPart("two.mcap", lambda _topic, time: time >= middle_ns),
        two=JoinedMember("two.mcap", 0, None, (SAME_TOPICS,)),
    )
    with open_bag(folder) as bag:
        assert told(bag) == expected
        assert [one.code for one in bag.findings] == ["SYN-520"]


def test_messages_that_are_left_out_are_gone_and_told(run: Path, tmp_path: Path) -> None:
    everything: Holds = lambda _topic, _time: True  # noqa: E731
    twice = JoinedMember("two.mcap", 0, 0, (SAME_TOPICS,), (), {"/imu/data": ((0, 10), (20, 22))})
    folder = joined(
        tmp_path, run, RecordingPart("one.mcap", of("lidar")), RecordingPart("two.mcap", everything), two=twice
    )
    with open_bag(run) as whole, open_bag(folder) as bag:
        imu = told(whole)["/imu/data"]
        assert told(bag)["/imu/data"] == imu[10:20] + imu[22:]
        heads = [(at, bytes(head)) for _, at, head in bag.heads(["/imu/data"])]
        assert heads == [(at, message[:8192]) for at, (_, message) in enumerate(imu[10:20] + imu[22:])]
        assert ("SYN-522", "/imu/data") in [(one.code, one.topic) for one in bag.findings]


def test_gaps_and_what_is_not_covered_are_told(run: Path, tmp_path: Path) -> None:
    with open_bag(run) as whole:
        start_ns, end_ns = whole.start_ns, whole.end_ns
    third_ns = (end_ns - start_ns) // 3
    folder = joined(
        tmp_path,
        run,
        RecordingPart("one.mcap", lambda _topic, time: time < start_ns + third_ns),
        RecordingPart("two.mcap", lambda _topic, time: time > end_ns - third_ns),
        RecordingPart("late.mcap", of("radar"), -5_000_000_000),
        two=JoinedMember("two.mcap", 0, None, (SAME_TOPICS,)),
        late=JoinedMember("late.mcap", 6_500_000_000, None, (GIVEN,)),
    )
    with open_bag(folder) as bag:
        found = {(one.code, one.topic) for one in bag.findings}
    assert ("SYN-527", "late.mcap") in found
    assert "SYN-528" in {code for code, _ in found}


def test_a_topic_of_two_types_is_refused(run: Path, tmp_path: Path) -> None:
    folder = joined(tmp_path, run, RecordingPart("one.mcap", of("lidar")), RecordingPart("two.mcap", of("imu")))
    path = (folder / "two.mcap").resolve()
    write_mcap(path, [Recorded("/lidar_points", "a/msg/B", 1, b"\0\1\0\0\1")])
    with refused_as("BAG-041", match="a/msg/B"):
        open_bag(folder)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda folder: (folder / "imu.mcap").unlink(),
        lambda folder: (folder / JOINED).write_bytes(b"{}"),
        lambda folder: (folder / JOINED).write_bytes(joined_bytes([JoinedMember("parts")])),
    ],
)
def test_a_folder_that_is_none_is_refused(three: Path, spoil: Callable[[Path], object]) -> None:
    spoil(three)
    with pytest.raises(JoinedFileError):
        open_bag(three)
    with pytest.raises(JoinedFileError):
        bag_paths(three)


def test_joined_recordings_are_recovered_one_by_one_and_a_member_that_is_no_bag_is_refused(three, tmp_path):
    with refused_as("BAG-019", match="name one of them"):
        recover(three, tmp_path / "whole.mcap")
    (three / "imu.mcap").unlink()
    (three / "imu.mcap").write_bytes(b"root:x:0:0")
    with pytest.raises(NotABagError):
        open_bag(three)


@pytest.mark.parametrize("stamp_ns", [0, 1, 2**31 * 10**9 - 1, -(10**9)])
@pytest.mark.parametrize("offset_ns", [-(10**18), -1, 1, 10**18])
def test_a_stamp_that_would_be_none_stays(stamp_ns: int, offset_ns: int) -> None:
    sec, nanosec = divmod(stamp_ns, 10**9)
    message = b"\0\1\0\0" + sec.to_bytes(4, "little", signed=True) + nanosec.to_bytes(4, "little") + b"rest"
    found = bytes(moved(memoryview(message), "header", offset_ns))
    would_be = stamp_ns + offset_ns
    fits = stamp_ns != 0 and 0 < would_be < 2**31 * 10**9
    told_ns = int.from_bytes(found[4:8], "little", signed=True) * 10**9 + int.from_bytes(found[8:12], "little")
    assert told_ns == (would_be if fits else stamp_ns)
    assert found[12:] == b"rest"


@pytest.mark.parametrize("content", [b"", b"\0\1", b"\0\0\0\0" + bytes(8), b"\7\7\7\7" + bytes(8), b"\0\1\0\0\0\0"])
def test_what_has_no_stamp_stays(content: bytes) -> None:
    assert bytes(moved(memoryview(content), "header", 5)) == content
    assert bytes(moved(memoryview(content), "transforms", 5)) == content


def test_transforms_are_moved_one_by_one_and_what_is_moved_depends_on_the_type(run: Path) -> None:
    with open_bag(run) as bag:
        message = bag.message("/tf_static", 0).payload
    whole = np.frombuffer(bytes(moved(message, "transforms", 10**9)), np.uint8)
    changed = np.flatnonzero(whole != np.frombuffer(message, np.uint8))
    assert len(changed) >= 5
    cut = bytes(moved(message[: len(message) // 2], "transforms", 10**9))
    assert cut == whole.tobytes()[: len(cut)]
    hostile = memoryview(b"\0\1\0\0" + b"\xff" * 64)
    assert len(moved(hostile, "transforms", 10**9)) == len(hostile)
    assert stamp_places(Topic("/tf", "tf2_msgs/msg/TFMessage", 1, ""), False) == "transforms"
    assert stamp_places(Topic("/a", "sensor_msgs/msg/Imu", 1, ""), True) == "header"
    assert stamp_places(Topic("/a", "std_msgs/msg/String", 1, ""), False) == "none"
