"""The sensor's own time is read out of the first bytes of its messages, or the message is refused by code."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stone_recordings.bags.errors import ByteOrderError, MessageLayoutError
from stone_recordings.bags.topic import Topic
from stone_recordings.clocks.sensor_times import OWN_TIME_BYTES, has_own_time, own_times
from stone_recordings.messages.types.registry import message_definition
from stone_recordings.report.scan import KeptMessage
from tests.stone_recordings.clocks.streams import INSPVAX, MS, RADAR, every, radar_lists, solutions
from tests.stone_recordings.writing import Recorded


def _topic(type_name: str) -> Topic:
    return Topic("/topic", type_name, 1, message_definition(type_name))


def _kept(messages: list[Recorded]) -> list[KeptMessage]:
    return [KeptMessage(memoryview(message.payload[:OWN_TIME_BYTES])) for message in messages]


@pytest.mark.parametrize("name", ["BESTPOS", "INSPVA", "INSPVAX"])
def test_every_log_of_the_receiver_carries_its_time(name: str) -> None:
    assert has_own_time(_topic(f"novatel_oem7_msgs/msg/{name}"))


@pytest.mark.parametrize("name", ["sensor_msgs/msg/Imu", "sensor_msgs/msg/NavSatFix", "nav_msgs/msg/Odometry"])
def test_standard_types_carry_the_headers_time_alone(name: str) -> None:
    assert not has_own_time(_topic(name))


def test_gps_time_is_utc_again() -> None:
    times_ns = every(50 * MS, 20)
    found = own_times(_topic(INSPVAX), _kept(solutions("/topic", times_ns, np.arange(20) * MS)))
    assert found.own_ns.tolist() == times_ns.tolist()
    assert found.late_ns.tolist() == (np.arange(20) * MS).tolist()
    assert found.total == 20


def test_a_radars_time_counts_only_where_it_was_synchronised() -> None:
    stamps_ns = every(50 * MS, 4)
    messages = [
        *radar_lists("/topic", stamps_ns, stamps_ns - 7),
        *radar_lists("/topic", stamps_ns, stamps_ns, status=3),
    ]
    found = own_times(_topic(RADAR), _kept(messages))
    assert found.late_ns.tolist() == [7] * 4
    assert found.total == 8


def test_no_messages_tell_nothing() -> None:
    assert own_times(_topic(INSPVAX), []).late_ns.tolist() == []


@settings(deadline=None, max_examples=200)
@given(
    type_name=st.sampled_from([INSPVAX, RADAR]),
    cut=st.integers(0, 120),
    place=st.integers(0, 80),
    garbage=st.binary(min_size=1, max_size=8),
)
def test_garbage_is_read_or_refused_by_code(type_name: str, cut: int, place: int, garbage: bytes) -> None:
    whole = {INSPVAX: _INSPVAX, RADAR: _LIST}[type_name]
    damaged = (whole[:place] + garbage + whole[place + len(garbage) :])[:cut]
    try:
        found = own_times(_topic(type_name), [KeptMessage(memoryview(damaged))])
    except (MessageLayoutError, ByteOrderError):
        return
    assert len(found.late_ns) <= 1


_INSPVAX = solutions("/topic", every(MS, 1), np.zeros(1, np.int64))[0].payload
_LIST = radar_lists("/topic", every(MS, 1), every(MS, 1))[0].payload
