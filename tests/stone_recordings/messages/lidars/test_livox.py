"""Livox's messages as `rosbags` serialises them are read to the last byte; hostile ones are refused."""

import struct
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from stone_recordings.bags.errors import IngestError, MessageLayoutError
from stone_recordings.messages.pointcloud2 import lidar_points
from stone_recordings.messages.sweep_clouds import points_declared, points_problem, sweep_cloud
from testing.worlds.field.point_messages import livox_definitions

TYPE = "livox_ros_driver2/msg/CustomMsg"
STAMP_NS = 1_700_000_000_123_456_789
Row = tuple[int, float, float, float, int, int, int]
FLOAT = st.floats(-1000, 1000, width=32)
ROW = st.tuples(st.integers(0, 2**32 - 1), FLOAT, FLOAT, FLOAT, *[st.integers(0, 255)] * 3)


def store() -> Typestore:
    made = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in livox_definitions():
        made.register(get_types_from_msg(text, name))
    return made


STORE = store()


def message(rows: list[Row], timebase_ns: int = STAMP_NS, frame_id: str = "livox_frame", point_num: int = 0) -> bytes:
    types = STORE.types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](*divmod(STAMP_NS, 10**9)), frame_id)
    points = [types["livox_ros_driver2/msg/CustomPoint"](*row) for row in rows]
    made: Any = types[TYPE](header, timebase_ns, point_num, 192, np.zeros(3, np.uint8), points)
    return bytes(STORE.serialize_cdr(made, TYPE))


@settings(max_examples=60, deadline=None)
@given(st.lists(ROW, max_size=9), st.text(st.characters(codec="ascii", exclude_characters="\0"), max_size=9))
def test_each_point_is_read_whatever_the_length_of_the_frame(rows: list[Row], frame_id: str) -> None:
    payload = memoryview(message(rows, frame_id=frame_id))
    cloud = sweep_cloud(payload, TYPE)
    assert (cloud.stamp_ns, cloud.frame_id, len(cloud.points)) == (STAMP_NS, frame_id, len(rows))
    assert points_declared(payload[:256], TYPE) == len(rows)
    assert points_problem(payload[:256], TYPE, lambda: len(payload)) == ""
    for read, (offset, x, y, z, reflectivity, _tag, line) in zip(cloud.points, rows, strict=True):
        assert (read["x"], read["y"], read["z"]) == (np.float32(x), np.float32(y), np.float32(z))
        assert (read["intensity"], read["ring"], read["time_stamp"]) == (reflectivity, line, offset)


@pytest.mark.parametrize(
    ("timebase_ns", "late_ns"),
    [(STAMP_NS, 0), (STAMP_NS - 50_000_000, -50_000_000), (0, 0), (668_000_000_000, 0), (2**64 - 1, 0)],
)
def test_a_time_base_is_used_where_it_is_of_the_stamps_clock(timebase_ns: int, late_ns: int) -> None:
    rows: list[Row] = [(offset, 1.0, 2.0, 3.0, 30, 16, 1) for offset in range(0, 100_000_000, 500_000)]
    found = lidar_points(sweep_cloud(memoryview(message(rows, timebase_ns)), TYPE))
    assert found.offset_ns is not None
    assert found.offset_ns.tolist() == [late_ns + row[0] for row in rows]


def test_the_number_of_points_that_the_message_repeats_is_not_looked_at() -> None:
    assert len(sweep_cloud(memoryview(message([(0, 1.0, 1.0, 1.0, 1, 1, 1)] * 3, point_num=9)), TYPE).points) == 3


def test_a_message_that_was_cut_or_counts_other_points_is_refused() -> None:
    whole = message([(0, 1.0, 1.0, 1.0, 1, 1, 1)] * 5)
    for cut in (whole[:-1], whole[:60], whole[:30], whole[:3], whole + bytes(9)):
        with pytest.raises(IngestError):
            sweep_cloud(memoryview(cut), TYPE)
        assert points_problem(memoryview(cut)[:256], TYPE, partial(len, cut)) != ""
    at = whole.index(struct.pack("<I", 5), 40)
    with pytest.raises(MessageLayoutError, match="declared"):
        sweep_cloud(memoryview(whole[:at] + struct.pack("<I", 2**32 - 1) + whole[at + 4 :]), TYPE)


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=200))
def test_no_bytes_do_more_than_be_refused(content: bytes) -> None:
    head = message([(0, 1.0, 1.0, 1.0, 1, 1, 1)])[:28]
    with suppress(IngestError):
        lidar_points(sweep_cloud(memoryview(head + content), TYPE))
