"""Every radar message gives the detections that rosbags would, cut into scans by offsets."""

from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from ruamel.yaml import YAML

from stone_recordings.bags.bag import open_bag
from stone_recordings.bags.errors import ByteOrderError, DefinitionMissingError, IngestError, MessageLayoutError
from stone_recordings.messages.radars import ars548
from stone_recordings.messages.radars.packets import DETECTION_LIST, TYPE, detection_lists
from stone_recordings.messages.radars.radar import RADAR_TYPES, RadarDetections, decode_radar
from stone_recordings.messages.types.registry import message_definition
from testing.refusals import refused_as
from tests.stone_recordings.messages.oracle import read_by_rosbags, wire
from tests.stone_recordings.writing import cloud_payload, header, made, random_message, serialised

ARS548, SCAN = "ars548_messages/msg/DetectionList", "radar_msgs/msg/RadarScan"
CONTINENTAL = "continental_msgs/msg/ContinentalArs548DetectionList"
CLOUD, LISTS = "sensor_msgs/msg/PointCloud2", frozenset({CONTINENTAL, SCAN})
NEBULA_CLOUD = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("azimuth", "<f4"), ("elevation", "<f4"), ("range", "<f4"),
     ("range_rate", "<f4"), ("rcs", "i1")]
)  # fmt: skip
UPO_CLOUD = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("v", "<f4"), ("r", "<f4"), ("RCS", "i1")])
seeds = st.integers(0, 2**32 - 1)


@lru_cache
def _list(seed: int, frame: str) -> bytes:
    """800 places of random bits."""
    message = random_message(ARS548, np.random.default_rng(seed))
    message.header.frame_id = frame
    return serialised(message)


def _lists(seed: int, counts: list[int], frames: list[str]) -> list[bytes]:
    """The count is followed by two floats and a byte."""
    wholes = [_list((seed + row) % 3, frames[row % len(frames)]) for row in range(len(counts))]
    return [whole[:-13] + count.to_bytes(4, "little") + whole[-9:] for whole, count in zip(wholes, counts, strict=True)]


def _floats(values: list[Any]) -> bytes:
    return np.array(values, np.float32).tobytes()


def _check(ours: RadarDetections, scans: list[list[Any]], names: dict[str, str]) -> None:
    assert ours.counts.tolist() == [len(scan) for scan in scans]
    flat = [detection for scan in scans for detection in scan]
    for mine, theirs in names.items():
        assert getattr(ours, mine).tobytes() == _floats([getattr(detection, theirs) for detection in flat]), mine


@pytest.mark.whole
@settings(max_examples=12)
@given(seed=seeds, counts=st.lists(st.integers(0, 800), max_size=5))
def test_a_detection_list_ends_where_its_count_says(seed: int, counts: list[int]) -> None:
    """The other places hold random bits, as they hold old detections on the robot; frames of two lengths are mixed."""
    messages = wire(_lists(seed, counts, ["radar_front", "r"]))
    theirs = read_by_rosbags(ARS548, messages)
    ours = decode_radar(ARS548, messages)
    names = {
        "azimuth_rad": "f_azimuthangle", "elevation_rad": "f_elevationangle", "range_m": "f_range",
        "range_rate_m_s": "f_rangerate", "rcs_db": "s_rcs",
    }  # fmt: skip
    scans = [message.list_detections[: message.list_numofdetections] for message in theirs]
    _check(ours, scans, names)
    stamps = [message.header.stamp.sec * 10**9 + message.header.stamp.nanosec for message in theirs]
    assert ours.stamps_ns.tolist() == stamps
    assert ours.sensor_stamps_ns is not None
    own = [message.timestamp_seconds * 10**9 + message.timestamp_nanoseconds for message in theirs]
    assert ours.sensor_stamps_ns.tolist() == own
    flags = [detection.u_invalidflags & 0b01010101 == 0 for scan in scans for detection in scan]
    finite = np.isfinite([ours.azimuth_rad, ours.elevation_rad, ours.range_m, ours.range_rate_m_s]).all(axis=0)
    assert ours.is_valid.tolist() == (np.array(flags, np.bool_) & finite).tolist()


def test_many_lists_are_the_sum_of_their_parts() -> None:
    """More than one batch, and a frame name that changes in between."""
    content = _lists(5, [3, 0, 800, 17, 250], ["front", "front", "front", "longer_name"])
    whole = decode_radar(ARS548, wire(content * 9))
    for row in range(45):
        alone = decode_radar(ARS548, wire([content[row % 5]]))
        assert whole.of(row).range_m.tobytes() == alone.range_m.tobytes()
        assert whole.of(row).is_valid.tolist() == alone.is_valid.tolist()
        assert whole.of(row).stamps_ns.tolist() == alone.stamps_ns.tolist()


@pytest.mark.parametrize("type_name", [ARS548, CONTINENTAL, SCAN, CLOUD])
def test_a_topic_in_portions_is_the_same_table(type_name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    generator = np.random.default_rng(8)
    contents = [serialised(random_message(type_name, generator)) for _ in range(9)] if type_name in LISTS else []
    contents = contents or _lists(3, [7, 0, 2, 800, 1], ["front"])
    if type_name == CLOUD:
        contents = [cloud_payload(_cloud(NEBULA_CLOUD, count, count)) for count in (3, 0, 9, 1)]
    whole = decode_radar(type_name, wire(contents))
    monkeypatch.setattr("stone_recordings.messages.radars.radar._PORTION", 2)
    parts = decode_radar(type_name, wire(contents))
    for name in ("stamps_ns", "offsets", "azimuth_rad", "range_m", "range_rate_m_s", "rcs_db", "is_valid"):
        assert getattr(parts, name).tobytes() == getattr(whole, name).tobytes()
    assert parts.points_radar.tobytes() == whole.points_radar.tobytes()
    assert (parts.sensor_stamps_ns is None) == (type_name != ARS548)


@settings(max_examples=40)
@given(seed=seeds, count=st.integers(0, 9))
def test_continental_lists_are_what_rosbags_reads(seed: int, count: int) -> None:
    generator = np.random.default_rng(seed)
    messages = wire([serialised(random_message(CONTINENTAL, generator)) for _ in range(count)])
    ours = decode_radar(CONTINENTAL, messages)
    scans = [message.detections for message in read_by_rosbags(CONTINENTAL, messages)]
    names = {
        "azimuth_rad": "azimuth_angle", "elevation_rad": "elevation_angle", "range_m": "range",
        "range_rate_m_s": "range_rate", "rcs_db": "rcs",
    }  # fmt: skip
    _check(ours, scans, names)
    for ok, detection in zip(ours.is_valid, (one for scan in scans for one in scan), strict=True):
        parts = (detection.invalid_distance, detection.invalid_azimuth, detection.invalid_elevation)
        values = (detection.azimuth_angle, detection.elevation_angle, detection.range, detection.range_rate)
        assert ok == (not any(parts) and not detection.invalid_range_rate and bool(np.isfinite(values).all()))


@settings(max_examples=40)
@given(seed=seeds, count=st.integers(0, 9))
def test_radar_scans_are_what_rosbags_reads(seed: int, count: int) -> None:
    generator = np.random.default_rng(seed)
    messages = wire([serialised(random_message(SCAN, generator)) for _ in range(count)])
    names = {
        "azimuth_rad": "azimuth", "elevation_rad": "elevation", "range_m": "range",
        "range_rate_m_s": "doppler_velocity", "rcs_db": "amplitude",
    }  # fmt: skip
    _check(decode_radar(SCAN, messages), [message.returns for message in read_by_rosbags(SCAN, messages)], names)


def _cloud(record: np.dtype[np.void], count: int, seed: int) -> NDArray[np.void]:
    points = np.zeros(count, record)
    generator = np.random.default_rng(seed)
    for name in record.names or ():
        points[name] = generator.uniform(-60, 60, count)
    return points


@pytest.mark.parametrize("record", [NEBULA_CLOUD, UPO_CLOUD])
def test_a_radar_cloud_keeps_its_points_and_its_speeds(record: np.dtype[np.void]) -> None:
    clouds = [_cloud(record, count, count) for count in (0, 1, 40)]
    ours = decode_radar(CLOUD, wire([cloud_payload(points) for points in clouds]))
    together = np.concatenate(clouds)
    assert ours.counts.tolist() == [0, 1, 40]
    np.testing.assert_array_equal(ours.points_radar, np.stack([together[name] for name in "xyz"], axis=1))
    names = record.names or ()
    np.testing.assert_array_equal(ours.range_rate_m_s, together["v" if "v" in names else "range_rate"])
    np.testing.assert_array_equal(ours.rcs_db, together["RCS" if "RCS" in names else "rcs"])
    if "range" in names:
        np.testing.assert_array_equal(ours.range_m, together["range"])
    else:
        np.testing.assert_allclose(ours.range_m, np.linalg.norm(ours.points_radar, axis=1), rtol=1e-6)


def test_a_cloud_without_speed_says_nan() -> None:
    points = np.ones(3, np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4")]))
    ours = decode_radar(CLOUD, wire([cloud_payload(points)]))
    assert np.isnan(ours.range_rate_m_s).all()
    assert np.isnan(ours.rcs_db).all()
    np.testing.assert_allclose(ours.azimuth_rad, np.pi / 4, rtol=1e-6)


@settings(max_examples=50)
@given(azimuth=st.floats(-3.1, 3.1), elevation=st.floats(-1.5, 1.5), distance=st.floats(0.1, 300))
def test_points_lie_at_their_range_in_their_direction(azimuth: float, elevation: float, distance: float) -> None:
    message = random_message(SCAN, np.random.default_rng(0))
    message.header = header(5, "radar")
    message.returns = [_return(azimuth, elevation, distance)]
    x, y, z = decode_radar(SCAN, wire([serialised(message)])).points_radar[0]
    assert np.hypot(np.hypot(x, y), z) == pytest.approx(distance, rel=1e-6)
    assert np.arctan2(y, x) == pytest.approx(azimuth, abs=1e-6)
    assert np.arcsin(z / distance) == pytest.approx(elevation, abs=1e-5)


def _return(azimuth: float, elevation: float, distance: float) -> Any:
    made = random_message("radar_msgs/msg/RadarReturn", np.random.default_rng(0), is_tame=True)
    made.azimuth, made.elevation, made.range = azimuth, elevation, distance
    return made


def test_a_list_that_is_too_long_or_big_endian_and_what_is_no_radars_are_refused() -> None:
    with pytest.raises(MessageLayoutError):
        decode_radar(ARS548, wire(_lists(1, [5, 801], ["front"])))
    with pytest.raises(DefinitionMissingError):
        decode_radar("sensor_msgs/msg/Imu", [])
    content = _lists(1, [2], ["front"])[0]
    with pytest.raises(ByteOrderError):
        decode_radar(ARS548, wire([content, b"\0\0" + content[2:]]))


def test_a_list_of_another_driver_is_followed_by_the_definition_it_embeds() -> None:
    """One place less in the list and a field more before it: only the recording knows."""
    text = message_definition(ARS548).replace("uint64 crc", "uint64 crc\nuint64 other").replace("[800]", "[3]")
    with pytest.raises(MessageLayoutError):
        decode_radar(ARS548, wire(_lists(1, [2], ["front"])), text)
    renamed = message_definition(ARS548).replace("s_rcs", "s_cross_section")
    with pytest.raises(MessageLayoutError):
        decode_radar(ARS548, wire(_lists(1, [2], ["front"])), renamed)


@pytest.mark.parametrize("type_name", sorted(RADAR_TYPES))
def test_no_messages_are_no_detections(type_name: str) -> None:
    ours = decode_radar(type_name, [])
    assert (len(ours), ours.offsets.tolist(), ours.points_radar.shape) == (0, [0], (0, 3))
    with pytest.raises(IndexError):
        ours.of(0)


@settings(max_examples=80)
@given(seed=seeds, at=st.integers(0, 300), junk=st.binary(min_size=1, max_size=8), is_cut=st.booleans())
def test_damaged_lists_are_read_or_refused_by_code(seed: int, at: int, junk: bytes, is_cut: bool) -> None:
    content = _lists(seed % 3, [4], ["front"])[0]
    place = at if seed % 2 else max(0, len(content) - at)
    damaged = content[:place] + junk + (b"" if is_cut else content[place + len(junk) :])
    code = "MSG-3"
    try:
        ars548.decode_ars548(wire([content, damaged]))
    except IngestError as error:
        code = error.code
    assert code.startswith("MSG-3")


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


def _list_of_radar_packets(count: int, seed: int = 0) -> NDArray[np.void]:
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


def test_packets_are_as_long_as_the_interface_says_or_refused() -> None:
    assert DETECTION_LIST.itemsize == 35_336
    with refused_as("MSG-308"):
        decode_radar(TYPE, wire([_message([_list_of_radar_packets(801).tobytes()])]))
    with refused_as("MSG-308"):
        decode_radar(TYPE, wire([_message([_list_of_radar_packets(1).tobytes()[:-1]])]))
    longer = _list_of_radar_packets(1)
    longer["length"] = 0xFFFFFFFF
    with refused_as("MSG-308"):
        decode_radar(TYPE, wire([_message([longer.tobytes()])]))


def test_other_packets_are_passed_over_and_lists_of_one_message_are_one_scan() -> None:
    status = (0).to_bytes(2, "big") + (380).to_bytes(2, "big") + bytes(80)
    first, second = _list_of_radar_packets(3, 1), _list_of_radar_packets(800, 2)
    sent = [_message([b"", b"\0", status, first.tobytes(), second.tobytes()]), _message([]), _message([status])]
    ours = decode_radar(TYPE, wire(sent))
    assert ours.counts.tolist() == [803, 0, 0]
    expected = np.concatenate([first["detections"][0][:3], second["detections"][0]])
    assert ours.range_m.tobytes() == expected["range"].astype(np.float32).tobytes()
    assert ours.sensor_stamps_ns is not None
    own = int(first["timestamp_seconds"][0]) * 10**9 + int(first["timestamp_nanoseconds"][0])
    assert ours.sensor_stamps_ns.tolist() == [own, 0, 0]


@settings(max_examples=60)
@given(at=st.integers(0, 150), junk=st.binary(min_size=1, max_size=6), is_cut=st.booleans())
def test_damaged_packets_are_read_or_refused_by_code(at: int, junk: bytes, is_cut: bool) -> None:
    content = _message([_list_of_radar_packets(5).tobytes(), b"abc"])
    damaged = content[:at] + junk + (b"" if is_cut else content[at + len(junk) :])
    code = "MSG-3"
    try:
        decode_radar(TYPE, wire([damaged]))
    except IngestError as error:
        code = error.code
    assert code.startswith("MSG-3")
