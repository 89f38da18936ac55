"""Raw ARS 548 packets decode to the truth that Nebula's own tests hold, field by field."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from ruamel.yaml import YAML

from stone_recordings.bags.bag import open_bag
from stone_recordings.bags.errors import IngestError
from stone_recordings.messages.errors import PacketError
from stone_recordings.messages.radars.packets import DETECTION_LIST, TYPE, detection_lists
from stone_recordings.messages.radars.radar import decode_radar
from tests.stone_recordings.messages.oracle import wire
from tests.stone_recordings.writing import header, made, serialised

RECORDING = "nebula_packets/nebula_continental/nebula_continental/test_resources/decoder_ground_truth/ars548"
STAMP_NS = 1_708_578_204_202_447_652
FLAGS = ("distance", "distance_std", "azimuth", "azimuth_std", "elevation", "elevation_std", "range_rate",
         "range_rate_std")  # fmt: skip
SAME_NAMES = ("azimuth_angle", "azimuth_angle_std", "elevation_angle", "elevation_angle_std", "range", "range_std",
              "range_rate", "range_rate_std", "rcs", "measurement_id", "classification", "object_id")  # fmt: skip
RAW_NAMES = ("positive_predictive_value", "multi_target_probability", "ambiguity_flag")
OF_LIST = {
    "stamp_sync_status": "timestamp_sync_status", "origin_pitch": "origin_pitch", "origin_yaw": "origin_yaw",
    "origin_pitch_std": "origin_pitch_std", "origin_yaw_std": "origin_yaw_std",
    "ambiguity_free_velocity_min": "velocity_min", "ambiguity_free_velocity_max": "velocity_max",
    "alignment_azimuth_correction": "azimuth_correction", "alignment_elevation_correction": "elevation_correction",
    "alignment_status": "alignment_status",
}  # fmt: skip


def _equal(ours: Any, written: Any) -> None:
    """The truth is written with six digits."""
    np.testing.assert_allclose(np.asarray(ours, np.float64), np.asarray(written, np.float64), rtol=6e-6, atol=1e-12)


@pytest.mark.field_data
def test_a_recording_without_definitions_decodes_to_its_written_truth(field_data: Path) -> None:
    folder = field_data / RECORDING
    truth = YAML(typ="safe").load((folder / "1708578204_202447652_detection.yaml").read_text())
    with open_bag(folder / "1708578204") as bag:
        (topic,) = bag.topics
        messages = list(bag.messages(topic.name))
    assert (topic.type, topic.schema, len(messages)) == (TYPE, "", 2)
    read = detection_lists(messages)
    assert (read.rows.tolist(), int(read.stamps_ns[1])) == ([1], STAMP_NS)
    assert truth["header"]["stamp"] == {"sec": STAMP_NS // 10**9, "nanosec": STAMP_NS % 10**9}
    _check_list(read.lists[0], truth)
    _check_detections(read.lists[0], truth["detections"])
    _check_columns(messages, truth["detections"])


def _check_list(ours: Any, truth: dict[str, Any]) -> None:
    assert ours["number_of_detections"] == len(truth["detections"]) == 308
    for theirs, name in OF_LIST.items():
        _equal(ours[name], truth[theirs])
    _equal([ours[f"origin_{axis}"] for axis in "xyz"], [truth["origin_pos"][axis] for axis in "xyz"])


def _check_detections(ours: Any, truth: list[dict[str, Any]]) -> None:
    found = ours["detections"][: len(truth)]
    for name in SAME_NAMES:
        _equal(found[name], [detection[name] for detection in truth])
    for name in RAW_NAMES:
        _equal(found[name], [detection[f"raw_{name}"] for detection in truth])
    for bit, name in enumerate(FLAGS):
        assert (found["invalid_flags"] >> bit & 1).tolist() == [detection[f"invalid_{name}"] for detection in truth]
    assert set(truth[0]) == {*SAME_NAMES, *(f"raw_{name}" for name in RAW_NAMES), *(f"invalid_{n}" for n in FLAGS)}


def _check_columns(messages: Any, truth: list[dict[str, Any]]) -> None:
    ours = decode_radar(TYPE, messages)
    assert ours.counts.tolist() == [0, len(truth)]
    _equal(ours.azimuth_rad, [detection["azimuth_angle"] for detection in truth])
    _equal(ours.range_rate_m_s, [detection["range_rate"] for detection in truth])
    assert ours.is_valid.all()
    assert ours.stamps_ns[1] == STAMP_NS
    # The packet arrived a quarter of a second after the radar's own stamp.
    assert ours.sensor_stamps_ns is not None
    assert STAMP_NS - ours.sensor_stamps_ns[1] == 246_687_652


def _list(count: int, seed: int = 0) -> NDArray[np.void]:
    """One detection list of random detections that says so."""
    one = np.frombuffer(np.random.default_rng(seed).bytes(DETECTION_LIST.itemsize), DETECTION_LIST).copy()
    one["service_id"], one["method_id"], one["length"] = 0, 336, DETECTION_LIST.itemsize - 8
    one["number_of_detections"] = count
    return one


def _message(packets: list[bytes]) -> bytes:
    stamp = made("builtin_interfaces/msg/Time", sec=1, nanosec=2)
    parts = [
        made("nebula_msgs/msg/NebulaPacket", stamp=stamp, data=np.frombuffer(packet, np.uint8)) for packet in packets
    ]
    return serialised(made(TYPE, header=header(7, "radar"), packets=parts))


def test_packets_are_as_long_as_the_interface_says() -> None:
    assert DETECTION_LIST.itemsize == 35_336


def test_other_packets_are_passed_over_and_lists_of_one_message_are_one_scan() -> None:
    status = (0).to_bytes(2, "big") + (380).to_bytes(2, "big") + bytes(80)
    first, second = _list(3, 1), _list(800, 2)
    sent = [_message([b"", b"\0", status, first.tobytes(), second.tobytes()]), _message([]), _message([status])]
    ours = decode_radar(TYPE, wire(sent))
    assert ours.counts.tolist() == [803, 0, 0]
    expected = np.concatenate([first["detections"][0][:3], second["detections"][0]])
    assert ours.range_m.tobytes() == expected["range"].astype(np.float32).tobytes()
    assert ours.sensor_stamps_ns is not None
    own = int(first["timestamp_seconds"][0]) * 10**9 + int(first["timestamp_nanoseconds"][0])
    assert ours.sensor_stamps_ns.tolist() == [own, 0, 0]


def test_a_list_that_lies_about_its_size_is_refused() -> None:
    with pytest.raises(PacketError, match=r"801 detections are declared, a list has 800 elements"):
        decode_radar(TYPE, wire([_message([_list(801).tobytes()])]))
    with pytest.raises(PacketError, match=r"a detection list of 35335 bytes declares 35328; it has 35336") as caught:
        decode_radar(TYPE, wire([_message([_list(1).tobytes()[:-1]])]))
    assert caught.value.code == "MSG-308"
    longer = _list(1)
    longer["length"] = 0xFFFFFFFF
    with pytest.raises(PacketError, match=r"35336 bytes declares 4294967295"):
        decode_radar(TYPE, wire([_message([longer.tobytes()])]))


@settings(max_examples=100, deadline=None)
@given(at=st.integers(0, 150), junk=st.binary(min_size=1, max_size=6), is_cut=st.booleans())
def test_damaged_packets_are_read_or_refused_by_code(at: int, junk: bytes, is_cut: bool) -> None:
    content = _message([_list(5).tobytes(), b"abc"])
    damaged = content[:at] + junk + (b"" if is_cut else content[at + len(junk) :])
    code = "MSG-3"
    try:
        decode_radar(TYPE, wire([damaged]))
    except IngestError as error:
        code = error.code
    assert code.startswith("MSG-3")
