"""One message that cannot be read costs itself."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stone_recordings.bags.errors import MessageLayoutError, PoseValueError
from stone_recordings.messages.problems import (
    MessageProblem,
    TopicHeads,
    head_problem,
    left_out_finding,
    majority,
    readable,
)
from testing.worlds.faults.edits import STORE, serialised


@dataclass(frozen=True)
class Note:
    payload: memoryview


def notes(*texts: bytes) -> list[Note]:
    return [Note(memoryview(text)) for text in texts]


def read(messages: list[Note]) -> int:
    """Messages are sound but for those that say "bad"."""
    if any(message.payload == b"bad" for message in messages):
        raise MessageLayoutError("note", "it is bad")
    return len(messages)


def test_those_that_can_be_read_are_left_and_the_others_said() -> None:
    good, findings = readable("/note", notes(b"a", b"bad", b"c", b"d", b"bad"), read)
    assert [bytes(message.payload) for message in good] == [b"a", b"c", b"d"]
    assert [(finding.code, finding.topic) for finding in findings] == [("MSG-311", "/note")]
    assert "2 of 5 messages cannot be read" in findings[0].message
    assert "number 1: note: it is bad" in findings[0].message


@pytest.mark.parametrize("texts", [(), (b"a", b"b"), (b"bad", b"bad")], ids=["none", "all good", "all bad"])
def test_nothing_is_left_out_where_all_or_none_can_be_read(texts: tuple[bytes, ...]) -> None:
    assert len(readable("/note", notes(*texts), read)[0]) == len(texts)
    assert readable("/note", notes(*texts), read)[1] == ()


def test_what_can_be_read_and_is_no_pose_is_for_its_decoder_to_say() -> None:
    def poses(messages: list[Note]) -> None:
        read(messages)
        raise PoseValueError("note", 0, "is not finite")

    assert len(readable("/note", notes(b"a", b"bad", b"c"), poses)[0]) == 2


def picture(data: bytes, stamp: int = 7) -> bytes:
    header = STORE.types["std_msgs/msg/Header"](STORE.types["builtin_interfaces/msg/Time"](stamp, 0), "camera")
    compressed = STORE.types["sensor_msgs/msg/CompressedImage"]
    return serialised(compressed(header, "jpeg", np.frombuffer(data, np.uint8)))


@pytest.mark.parametrize(
    ("head", "code", "reason"),
    [
        (picture(b"\xff\xd8\xff and more"), "", ""),
        (picture(b"\xff\xd8\xff", stamp=0), "no_stamp", "its stamp is 0"),
        (picture(b"noise"), "malformed_sweep", "neither JPEG nor PNG"),
        (picture(b""), "malformed_sweep", "first bytes none"),
        (picture(b"\xff\xd8\xff and more")[:-4], "malformed_sweep", "its picture ends at byte"),
        (picture(b"\xff\xd8\xff")[:10], "malformed_sweep", "8 bytes are declared at"),
        (b"\0\0" + picture(b"\xff\xd8\xff")[2:], "malformed_sweep", "big-endian"),
        (b"", "malformed_sweep", "0 bytes are not a CDR message"),
    ],
)
def test_the_first_bytes_tell_what_is_wrong(head: bytes, code: str, reason: str) -> None:
    found = head_problem(memoryview(head), "sensor_msgs/msg/CompressedImage", lambda: len(head))
    assert (found.code if found else "") == code
    assert reason in (found.reason if found else "")


def test_what_lies_in_damaged_chunks_is_said_by_the_recording_and_not_again() -> None:
    damaged, other = MessageProblem("damaged_chunk", "CRC"), MessageProblem("no_stamp", "its stamp is 0")
    stamps_ns = np.array([10, 20, 30], np.int64)
    assert left_out_finding("/a", {0: damaged}, stamps_ns) == ()
    (found,) = left_out_finding("/a", {0: damaged, 2: other}, stamps_ns)
    assert "1 of 3 messages are left out (the first at 30 ns: its stamp is 0)" in found.message


def test_of_words_as_common_the_first_counts() -> None:
    assert [majority(words) for words in ([], ["b", "a"], ["b", "a", "a"])] == ["", "b", "a"]


IMU = "sensor_msgs/msg/Imu"


def imu_head(seconds: int, nanoseconds: int, frame_id: bytes, behind: bytes, encapsulation: bytes) -> bytes:
    stamp = seconds.to_bytes(4, "little", signed=True) + nanoseconds.to_bytes(4, "little")
    return encapsulation + stamp + len(frame_id).to_bytes(4, "little") + frame_id + behind


heads = st.builds(
    imu_head,
    st.sampled_from([0, 1, -1, 1_700_000_000]),
    st.sampled_from([0, 5, 1_000_000_000]),
    st.sampled_from([b"imu\0", b"\0", b"", b"other\0", b"\xff\xff"]),
    st.sampled_from([b"", b"more"]),
    st.sampled_from([b"\0\1\0\0", b"\0\0\0\0", b"\0\2\0\0"]),
)


@given(
    st.lists(st.tuples(heads, st.integers(0, 40)), max_size=12), st.sampled_from([IMU, "sensor_msgs/msg/CameraInfo"])
)
def test_a_topic_s_heads_are_each_told_as_alone(cut: list[tuple[bytes, int]], type_name: str) -> None:
    topic = TopicHeads(type_name)
    for head, bytes_left in cut:
        view = memoryview(head[: max(0, len(head) - bytes_left // 4)])
        assert topic.problem(view, lambda: 0) == head_problem(view, type_name, lambda: 0)
