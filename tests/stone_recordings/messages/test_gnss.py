"""Positions of any receiver, and what cameras say of themselves, are what rosbags reads."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stone_recordings.bags.bag import open_bag
from stone_recordings.messages.camera_info import decode_camera_info
from stone_recordings.messages.gnss import GNSS_TYPES, NAVSATFIX, decode_gnss
from stone_recordings.messages.types.registry import typestore
from tests.stone_recordings.messages.oracle import read_by_rosbags, wire
from tests.stone_recordings.writing import random_message, serialised

INFO = "sensor_msgs/msg/CameraInfo"
SAME = {"latitude_deg": "latitude", "longitude_deg": "longitude", "height_m": "altitude"}
MOTION = {"speed_m_s": "speed", "track_deg": "track", "climb_m_s": "climb"}
seeds, counts = st.integers(0, 2**32 - 1), st.integers(0, 8)


def _check(ours: Any, theirs: list[Any], names: dict[str, str]) -> None:
    stamps = [message.header.stamp.sec * 10**9 + message.header.stamp.nanosec for message in theirs]
    assert ours.stamps_ns.tolist() == stamps
    for mine, name in names.items():
        expected = np.array([getattr(message, name) for message in theirs], np.float64)
        assert getattr(ours, mine).tobytes() == expected.tobytes()
    assert ours.status.tolist() == [message.status.status for message in theirs]
    covariances = np.array([message.position_covariance for message in theirs], np.float64)
    assert ours.covariance_enu_m2.tobytes() == covariances.tobytes()


@settings(max_examples=30, deadline=None)
@given(type_name=st.sampled_from(sorted(GNSS_TYPES)), seed=seeds, count=counts)
def test_positions_are_what_rosbags_reads(type_name: str, seed: int, count: int) -> None:
    generator = np.random.default_rng(seed)
    messages = wire([serialised(random_message(type_name, generator)) for _ in range(count)])
    ours = decode_gnss(type_name, messages)
    names = SAME if type_name == NAVSATFIX else SAME | MOTION
    _check(ours, read_by_rosbags(type_name, messages), names)
    assert (ours.speed_m_s is None) == (type_name == NAVSATFIX)
    assert ours.height_above == ("ellipsoid" if type_name == NAVSATFIX else "mean sea level")


def test_a_position_without_fix_or_without_number_is_none() -> None:
    messages = [random_message(NAVSATFIX, np.random.default_rng(1), is_tame=True) for _ in range(3)]
    for message, status in zip(messages, (-1, 0, 2), strict=True):
        message.status.status = status
    messages[2].longitude = float("nan")
    ours = decode_gnss(NAVSATFIX, wire([serialised(message) for message in messages]))
    assert ours.is_fixed.tolist() == [False, True, False]


@pytest.mark.field_data
def test_the_drivers_own_fixes_are_what_rosbags_reads(field_data: Path) -> None:
    with open_bag(field_data / "novatel_oem7/bestpos_ros2_mcap/bestpos_ros2_mcap.mcap") as bag:
        for name in ("/gps/fix", "/gps/gps"):
            topic = next(known for known in bag.topics if known.name == name)
            messages = list(bag.messages(name))
            theirs = [typestore().deserialize_cdr(message.payload, topic.type) for message in messages]
            for schema in ("", topic.schema):
                ours = decode_gnss(topic.type, messages, schema)
                _check(ours, theirs, SAME)
                assert len(ours.stamps_ns) == 12
                assert ours.is_fixed.all()
                assert np.allclose(ours.latitude_deg, 51.15, atol=0.1)  # NovAtel, Calgary


@settings(max_examples=30, deadline=None)
@given(seed=seeds, picks=st.lists(st.integers(0, 2), max_size=9))
def test_camera_infos_are_kept_once_each(seed: int, picks: list[int]) -> None:
    generator = np.random.default_rng(seed)
    distinct = [random_message(INFO, generator) for _ in range(3)]
    for message, width in zip(distinct, (640, 1280, 1920), strict=True):
        message.width = width
    sent = wire([serialised(distinct[pick]) for pick in picks])
    ours = decode_camera_info(sent)
    assert [ours.infos[which].width_px for which in ours.which] == [(640, 1280, 1920)[pick] for pick in picks]
    assert len(ours.infos) == len(set(picks))
    for info, message in zip((ours.infos[which] for which in ours.which), read_by_rosbags(INFO, sent), strict=True):
        assert (info.frame_id, info.model, info.height_px) == (
            message.header.frame_id, message.distortion_model, message.height,
        )  # fmt: skip
        for mine, name in (("distortion", "d"), ("k", "k"), ("r", "r"), ("p", "p")):
            assert getattr(info, mine).tobytes() == np.asarray(getattr(message, name)).tobytes()
        assert info.binning == (message.binning_x, message.binning_y)
        roi = message.roi
        assert info.roi_px == (roi.x_offset, roi.y_offset, roi.width, roi.height)
        assert info.is_calibrated == (message.k[0] != 0)
