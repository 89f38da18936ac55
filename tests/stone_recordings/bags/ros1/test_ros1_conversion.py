"""What ROS 1 serialised becomes the CDR that rosbags makes of it; what contradicts itself is refused by its decoder."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stone_recordings.bags.errors import DefinitionMissingError, MessageLayoutError
from stone_recordings.bags.ros1.catalogue import Ros1Type
from stone_recordings.bags.ros1.definitions import MOST_ELEMENTS, conversion_of, ros2_type
from stone_recordings.messages.errors import DefinitionRefusedError
from stone_recordings.messages.types.registry import registry, resolved, typestore
from stone_recordings.messages.types.table import decode_table
from stone_recordings.sync.recorded_messages import OwnMessage
from testing.worlds.ros1_bags import ros1_types
from tests.stone_recordings.writing import random_message, serialised

TYPES = (
    "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/Imu", "sensor_msgs/msg/CameraInfo", "sensor_msgs/msg/NavSatFix",
    "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/JointState", "nav_msgs/msg/Odometry", "nav_msgs/msg/Path",
    "nav_msgs/msg/OccupancyGrid", "tf2_msgs/msg/TFMessage", "geometry_msgs/msg/PolygonStamped",
    "trajectory_msgs/msg/JointTrajectory",
    "diagnostic_msgs/msg/DiagnosticArray", "sensor_msgs/msg/MultiDOFJointState", "std_msgs/msg/Float64MultiArray",
    "novatel_oem7_msgs/msg/INSPVAX",
)  # fmt: skip


def ros1_of(type_name: str) -> Ros1Type:
    """As a connection tells it."""
    text, _md5 = ros1_types().generate_msgdef(type_name, ros_version=1)
    return Ros1Type(type_name.replace("/msg/", "/"), text)


@pytest.mark.parametrize("type_name", TYPES)
@settings(max_examples=15)
@given(seed=st.integers(0, 2**32))
def test_random_messages_become_what_another_library_serialises(type_name: str, seed: int) -> None:
    message = random_message(type_name, np.random.default_rng(seed))
    cdr = serialised(message)
    ros1 = typestore().cdr_to_ros1(cdr, type_name)
    assert conversion_of(ros1_of(type_name)).of_message(memoryview(ros1)) == cdr


@given(seed=st.integers(0, 2**32), most_bytes=st.integers(1, 3000), cut=st.floats(0, 1))
def test_a_head_is_a_beginning_however_little_of_the_message_is_there(seed: int, most_bytes: int, cut: float) -> None:
    type_name = "diagnostic_msgs/msg/DiagnosticArray"
    cdr = serialised(random_message(type_name, np.random.default_rng(seed)))
    ros1 = memoryview(typestore().cdr_to_ros1(cdr, type_name))
    head = conversion_of(ros1_of(type_name)).of_head(ros1[: int(cut * len(ros1))], most_bytes)
    assert cdr[: len(head.payload)] == head.payload
    assert head.read_bytes <= int(cut * len(ros1))
    assert len(conversion_of(ros1_of(type_name)).of_head(ros1, most_bytes).payload) >= min(most_bytes, len(cdr))


@given(seed=st.integers(0, 2**32), cut=st.integers(1, 60))
def test_a_message_that_ends_early_or_late_is_refused_by_whoever_decodes_it(seed: int, cut: int) -> None:
    type_name = "nav_msgs/msg/Odometry"
    conversion = conversion_of(ros1_of(type_name))
    ros1 = bytes(typestore().cdr_to_ros1(serialised(random_message(type_name, np.random.default_rng(seed))), type_name))
    for wrong in (ros1[:-cut], ros1 + bytes(cut + 3)):
        with pytest.raises(MessageLayoutError):
            decode_table(type_name, [OwnMessage(conversion.of_message(memoryview(wrong)))], registry())


@given(content=st.binary(max_size=200), type_name=st.sampled_from(TYPES))
def test_no_bytes_make_a_conversion_fail_or_grow(content: bytes, type_name: str) -> None:
    converted = conversion_of(ros1_of(type_name)).of_message(memoryview(content))
    assert len(converted) <= 2 * len(content) + 2**17


def test_packets_of_drivers_that_are_unknown_here_become_cdr_as_their_definition_says() -> None:
    text = (
        "Header header\nVelodynePacket[] packets\n" + "=" * 80 + "\nMSG: velodyne_msgs/VelodynePacket\n"
        "time stamp\nuint8[1206] data\n"
        + "=" * 80
        + "\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
    )
    told = Ros1Type("velodyne_msgs/VelodyneScan", text)
    header = (7).to_bytes(4, "little") + bytes(8) + (8).to_bytes(4, "little") + b"velodyne"
    packets = [bytes([number]) * 8 + bytes([number + 100]) * 1206 for number in range(5)]
    ros1 = header + (5).to_bytes(4, "little") + b"".join(packets)
    named = ros2_type(told)
    assert named.name == "velodyne_msgs/msg/VelodyneScan"
    payload = conversion_of(told).of_message(memoryview(ros1))
    table = decode_table(named.name, [OwnMessage(payload)], resolved(*named).registry)
    assert table.texts("header.frame_id") == ["velodyne"]
    offsets, data = table.ragged("packets.stamp.sec")
    assert (offsets.tolist(), [value & 0xFF for value in data.tolist()]) == ([0, 5], [0, 1, 2, 3, 4])
    assert payload[-1206:] == packets[-1][8:]


def test_fields_have_the_names_that_are_known_here_and_one_that_ros2_lacks_stays() -> None:
    named = ros2_type(ros1_of("sensor_msgs/msg/CameraInfo"))
    assert "float64[9] k\n" in named.schema
    assert resolved(*named).findings == ()
    assert "seq" not in named.schema
    text = (
        "Header header\nfloat64 range\nfloat64 mine\n" + ros1_of("sensor_msgs/msg/Imu").definition.partition("\n=")[1]
    )
    text += "=" * 79 + "\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
    named = ros2_type(Ros1Type("sensor_msgs/Imu", text))
    assert "float64 mine\n" in named.schema
    assert [finding.code for finding in resolved(*named).findings] == ["MSG-309"]


def test_a_connection_that_describes_nothing_is_of_noetic_or_missing() -> None:
    assert ros2_type(Ros1Type("sensor_msgs/Imu", " \n")) == ros2_type(ros1_of("sensor_msgs/msg/Imu"))
    with pytest.raises(DefinitionMissingError):
        ros2_type(Ros1Type("acme_msgs/Own", ""))
    with pytest.raises(DefinitionRefusedError):
        ros2_type(Ros1Type("no type at all", "uint8 x\n"))
    with pytest.raises(DefinitionRefusedError):
        ros2_type(Ros1Type("acme_msgs/Own", "Other x\n"))
    told = Ros1Type("std_msgs/Empty", "# nothing\n")
    payload = conversion_of(told).of_message(memoryview(b""))
    assert payload == b"\0\1\0\0\0"
    assert typestore().deserialize_cdr(payload, "std_msgs/msg/Empty")


EMPTY = "=" * 80 + "\nMSG: std_msgs/Empty\n"


@pytest.mark.parametrize(
    "text",
    [
        f"std_msgs/Empty[] endless\n{EMPTY}",
        f"std_msgs/Empty[1000000] many\n{EMPTY}",
        f"Own[] endless\n{'=' * 80}\nMSG: acme_msgs/Own\nstd_msgs/Empty[1000] x\n{EMPTY}",
    ],
)
def test_elements_that_take_no_bytes_cannot_make_a_message_grow(text: str) -> None:
    told = Ros1Type("acme_msgs/All", text)
    converted = conversion_of(told).of_message(memoryview((2**32 - 1).to_bytes(4, "little")))
    assert len(converted) <= MOST_ELEMENTS
