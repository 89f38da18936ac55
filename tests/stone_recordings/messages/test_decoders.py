"""Every vectorised decoder agrees with rosbags, bit for bit, whatever the strings and however messages are mixed."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory

from stone_recordings.bags import errors
from stone_recordings.bags.errors import IngestError
from stone_recordings.messages.imu import decode_imu
from stone_recordings.messages.novatel import decode_bestpos, decode_inspva, unix_ns
from stone_recordings.messages.odometry import decode_odometry
from stone_recordings.messages.tf import decode_transforms
from stone_recordings.messages.types.registry import message_definition, typestore
from testing.refusals import refused_as
from tests.stone_recordings.writing import header, made, random_message, serialised

IMU, ODOMETRY, TF = "sensor_msgs/msg/Imu", "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage"
NOVATEL = "novatel_oem7_msgs/msg"

seeds = st.integers(0, 2**32 - 1)
counts = st.integers(0, 8)


@dataclass(frozen=True)
class Message:
    payload: memoryview


def _message(content: bytes) -> Message:
    return Message(memoryview(content))


def _wire(messages: list[Any]) -> list[Message]:
    return [_message(serialised(message)) for message in messages]


def _stamp_ns(message: Any) -> int:
    return int(message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec)


def _same_bits(ours: Any, theirs: Any) -> bool:
    """NaN payloads included."""
    left = np.ascontiguousarray(ours)
    right = np.array(theirs, left.dtype).reshape(left.shape)
    return left.tobytes() == right.tobytes()


def _three(vector: Any) -> tuple[float, float, float]:
    return vector.x, vector.y, vector.z


@settings(max_examples=30)
@given(seed=seeds, count=counts)
def test_imu_is_what_rosbags_reads(seed: int, count: int) -> None:
    generator = np.random.default_rng(seed)
    wire = _wire([random_message(IMU, generator) for _ in range(count)])
    theirs = [typestore().deserialize_cdr(message.payload, IMU) for message in wire]
    ours = decode_imu(wire)
    assert ours.stamps_ns.tolist() == [_stamp_ns(message) for message in theirs]
    assert _same_bits(ours.angular_velocity_rad_s, [_three(message.angular_velocity) for message in theirs])
    assert _same_bits(ours.linear_acceleration_m_s2, [_three(message.linear_acceleration) for message in theirs])


@settings(max_examples=30)
@given(seed=seeds, count=counts)
def test_odometry_is_what_rosbags_reads(seed: int, count: int) -> None:
    generator = np.random.default_rng(seed)
    messages = [random_message(ODOMETRY, generator, is_tame=True) for _ in range(count)]
    for message in messages:
        message.header.frame_id, message.child_frame_id = "odom", "base_é"
    wire = _wire(messages)
    theirs = [typestore().deserialize_cdr(message.payload, ODOMETRY) for message in wire]
    ours = decode_odometry(wire)
    assert ours.stamps_ns.tolist() == [_stamp_ns(message) for message in theirs]
    assert (ours.frame_id, ours.child_frame_id) == (("odom", "base_é") if count else ("", ""))
    positions = [_three(message.pose.pose.position) for message in theirs]
    assert _same_bits(ours.parent_from_child.translation_m, positions)
    for row, message in enumerate(theirs):
        turn = message.pose.pose.orientation
        wxyz = np.array([turn.w, turn.x, turn.y, turn.z])
        np.testing.assert_allclose(ours.parent_from_child.wxyz[row], wxyz / np.linalg.norm(wxyz), atol=1e-15)


@settings(max_examples=30)
@given(seed=seeds, count=counts)
def test_transforms_are_what_rosbags_reads_sorted_by_pair(seed: int, count: int) -> None:
    generator = np.random.default_rng(seed)
    messages = [random_message(TF, generator, is_tame=True) for _ in range(count)]
    names = ("map", "odom", "base_link")
    for transform in (transform for message in messages for transform in message.transforms):
        transform.header.frame_id, transform.child_frame_id = generator.choice(names, 2)
    wire = _wire(messages)
    expected: dict[tuple[str, str], list[Any]] = {}
    for message in wire:
        for transform in typestore().deserialize_cdr(message.payload, TF).transforms:
            expected.setdefault((transform.header.frame_id, transform.child_frame_id), []).append(transform)
    ours = decode_transforms(wire)
    assert [(samples.parent, samples.child) for samples in ours] == sorted(expected)
    for samples in ours:
        theirs = expected[samples.parent, samples.child]
        assert samples.stamps_ns.tolist() == [_stamp_ns(transform) for transform in theirs]
        translations = [_three(transform.transform.translation) for transform in theirs]
        assert _same_bits(samples.parent_from_child.translation_m, translations)


INS_COLUMNS = {"latitude_deg": "latitude", "longitude_deg": "longitude", "height_m": "height"} | {
    f"{name}_deg": name for name in ("roll", "pitch", "azimuth")
}


def _check_ins(ours: Any, theirs: list[Any]) -> None:
    assert ours.host_stamps_ns.tolist() == [_stamp_ns(message) for message in theirs]
    for mine, name in INS_COLUMNS.items():
        assert _same_bits(getattr(ours, mine), [getattr(message, name) for message in theirs])
    velocities = [(m.east_velocity, m.north_velocity, m.up_velocity) for m in theirs]
    assert _same_bits(ours.velocity_enu_m_s, velocities)
    for row, message in enumerate(theirs):
        head = message.nov_header
        time_ns = unix_ns(np.array([head.gps_week_number]), np.array([head.gps_week_milliseconds]))[0]
        assert ours.gps_stamps_ns[row] == (time_ns if head.gps_week_number else 0)


@settings(max_examples=50)
@given(type_name=st.sampled_from([f"{NOVATEL}/INSPVA", f"{NOVATEL}/INSPVAX"]), seed=seeds, count=counts)
def test_solutions_of_an_ins_are_what_rosbags_reads(type_name: str, seed: int, count: int) -> None:
    generator = np.random.default_rng(seed)
    wire = _wire([random_message(type_name, generator) for _ in range(count)])
    theirs = [typestore().deserialize_cdr(message.payload, type_name) for message in wire]
    ours = decode_inspva(wire)
    _check_ins(ours, theirs)
    if not count or type_name.endswith("INSPVA"):
        assert ours.ins_status.tolist() == [message.status.status for message in theirs]
        assert (ours.pos_type, ours.position_stdev_m) == (None, None)
        return
    assert ours.ins_status.tolist() == [message.ins_status.status for message in theirs]
    assert ours.pos_type is not None
    assert ours.pos_type.tolist() == [message.pos_type.type for message in theirs]
    stdevs = [(m.latitude_stdev, m.longitude_stdev, m.height_stdev) for m in theirs]
    assert ours.position_stdev_m is not None
    np.testing.assert_array_equal(ours.position_stdev_m, np.array(stdevs, np.float64))


def _bestpos(generator: np.random.Generator, store: Any = None) -> Any:
    message = random_message(f"{NOVATEL}/BESTPOS", generator)
    message.sol_status.status, message.pos_type.type = int(generator.integers(0, 23)), int(generator.integers(0, 81))
    message.lat, message.lon = generator.uniform(-90, 90), generator.uniform(-180, 180)
    return message


@settings(max_examples=30)
@given(seed=seeds, count=counts)
def test_bestpos_is_what_rosbags_reads(seed: int, count: int) -> None:
    generator = np.random.default_rng(seed)
    wire = _wire([_bestpos(generator) for _ in range(count)])
    theirs = [typestore().deserialize_cdr(message.payload, f"{NOVATEL}/BESTPOS") for message in wire]
    _check_fix(decode_bestpos(wire), theirs)


def _check_fix(ours: Any, theirs: list[Any]) -> None:
    assert ours.host_stamps_ns.tolist() == [_stamp_ns(message) for message in theirs]
    assert ours.sol_status.tolist() == [message.sol_status.status for message in theirs]
    assert ours.pos_type.tolist() == [message.pos_type.type for message in theirs]
    assert ours.time_status.tolist() == [message.nov_header.time_status for message in theirs]
    for mine, name in {"latitude_deg": "lat", "longitude_deg": "lon", "height_msl_m": "hgt"}.items():
        assert _same_bits(getattr(ours, mine), [getattr(message, name) for message in theirs])
    stdevs = [(m.lat_stdev, m.lon_stdev, m.hgt_stdev) for m in theirs]
    np.testing.assert_array_equal(ours.position_stdev_m, np.array(stdevs, np.float64).reshape(-1, 3))


DECODERS = {
    IMU: decode_imu, ODOMETRY: decode_odometry, TF: decode_transforms, f"{NOVATEL}/INSPVAX": decode_inspva,
    f"{NOVATEL}/BESTPOS": decode_bestpos,
}  # fmt: skip


@settings(max_examples=80)
@given(
    type_name=st.sampled_from(sorted(DECODERS)),
    seed=seeds,
    ratio=st.floats(0, 1, exclude_max=True),
    junk=st.binary(max_size=8),
    is_cut=st.booleans(),
)
def test_damaged_messages_are_read_or_refused_by_code(type_name, seed, ratio, junk, is_cut):
    generator = np.random.default_rng(seed)
    whole, other = (serialised(random_message(type_name, generator, is_tame=True)) for _ in range(2))
    at = int(ratio * len(whole))
    damaged = whole[:at] + junk + (b"" if is_cut else whole[at + len(junk) :])
    try:
        DECODERS[type_name]([_message(other), _message(damaged)])
    except IngestError as error:
        refusal = error
    else:
        refusal = None
    assert refusal is None or refusal.code.startswith("MSG-3")


def _odometry(parent: str = "odom", child: str = "base", norm: float = 1.0, x: float = 0.0) -> bytes:
    message = random_message(ODOMETRY, np.random.default_rng(0), is_tame=True)
    message.header, message.child_frame_id = header(5, parent), child
    message.pose.pose.position = made("geometry_msgs/msg/Point", x=x, y=0.0, z=0.0)
    message.pose.pose.orientation = made("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=norm)
    return serialised(message)


def test_two_sources_or_two_types_on_one_topic_are_refused() -> None:
    with refused_as("MSG-304"):
        decode_odometry([_message(_odometry()), _message(_odometry(child="imu"))])
    generator = np.random.default_rng(4)
    wire = _wire([random_message(f"{NOVATEL}/{name}", generator) for name in ("INSPVA", "INSPVAX")])
    with pytest.raises(errors.MessageLayoutError):
        decode_inspva(wire)


def test_a_message_without_a_pose_costs_itself_and_where_none_has_one_the_first_is_named() -> None:
    bad = [_odometry(norm=0.0), _odometry(x=float("nan")), _odometry(norm=1e200)]
    found = decode_odometry([_message(payload) for payload in (_odometry(x=1.0), *bad, _odometry(x=2.0))])
    assert found.parent_from_child.translation_m[:, 0].tolist() == [1.0, 2.0]
    assert len(found.stamps_ns) == 2
    assert len(found.refused_ns) == 3
    assert found.reason == "has a quaternion of norm 0"
    with pytest.raises(errors.PoseValueError):
        decode_odometry([_message(_odometry(norm=0.0))])
    with pytest.raises(errors.PoseValueError):
        decode_odometry([_message(_odometry(x=float("nan")))])
    with pytest.raises(errors.PoseValueError):
        decode_odometry([_message(_odometry(norm=1e200))])


def test_big_endian_messages_other_types_and_false_counts_are_refused() -> None:
    content = _odometry()
    with pytest.raises(errors.ByteOrderError):
        decode_odometry([_message(b"\x00\x00" + content[2:])])
    with pytest.raises(errors.MessageLayoutError):
        decode_odometry([_message(b"\x00\x03" + content[2:])])
    with pytest.raises(errors.MessageLayoutError):
        decode_odometry([_message(b"\x00\x01")])
    content = serialised(random_message(IMU, np.random.default_rng(1)))
    with pytest.raises(errors.MessageLayoutError):
        decode_odometry([_message(content)])
    with pytest.raises(errors.MessageLayoutError):
        decode_imu([_message(_odometry())])
    with pytest.raises(errors.MessageLayoutError):
        decode_bestpos([_message(content)])
    with pytest.raises(errors.MessageLayoutError):
        decode_transforms([_message(b"\x00\x01\x00\x00\xff\xff\xff\xff")])


OWN = ("BESTPOS", "INSPVA", "INSPVAX")
TYPES = (
    *(f"novatel_oem7_msgs/msg/{name}" for name in OWN), "ars548_messages/msg/DetectionList",
    "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/CameraInfo",
    "tf2_msgs/msg/TFMessage",
)  # fmt: skip


@pytest.mark.parametrize("type_name", TYPES)
def test_another_decoder_reads_messages_by_it(type_name: str) -> None:
    decode = DecoderFactory().decoder_for(
        "cdr", Schema(1, message_definition(type_name).encode(), "ros2msg", type_name)
    )
    message = random_message(type_name, np.random.default_rng(7), is_tame=True)
    assert decode is not None
    assert decode(serialised(message)).header.frame_id == message.header.frame_id if "TF" not in type_name else True


def test_a_list_of_800_detections_is_as_long_as_its_driver_says_and_an_unknown_type_refused() -> None:
    """Driver's own layout (ars548_ros): 41,741 bytes for a frame name of eleven characters."""
    message = random_message("ars548_messages/msg/DetectionList", np.random.default_rng(0))
    message.header.frame_id = "radar_front"
    assert len(serialised(message)) == 41_741
    with pytest.raises(errors.DefinitionMissingError):
        message_definition("my_msgs/msg/Thing")
