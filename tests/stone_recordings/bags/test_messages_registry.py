"""Definitions are those that every other reader of ROS 2 understands."""

from pathlib import Path

import numpy as np
import pytest
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory
from rosbags.typesys import get_types_from_msg

from stone_recordings.bags.errors import DefinitionMissingError
from stone_recordings.messages.types.registry import message_definition, typestore
from tests.stone_recordings.writing import random_message, serialised

OWN = ("BESTPOS", "INSPVA", "INSPVAX")
TYPES = (
    *(f"novatel_oem7_msgs/msg/{name}" for name in OWN),
    "ars548_messages/msg/DetectionList",
    "sensor_msgs/msg/PointCloud2",
    "sensor_msgs/msg/CompressedImage",
    "sensor_msgs/msg/CameraInfo",
    "tf2_msgs/msg/TFMessage",
)


@pytest.mark.parametrize("type_name", TYPES)
def test_a_definition_holds_everything_the_type_needs(type_name: str) -> None:
    """Parsed alone it gives the fields of the type and of all types in it."""
    text = message_definition(type_name)
    parsed = get_types_from_msg(text, type_name)
    assert parsed[type_name][1] == typestore().fielddefs[type_name][1]
    assert text.count("=" * 80) == len(parsed) - 1


@pytest.mark.parametrize("type_name", TYPES)
def test_another_decoder_reads_messages_by_it(type_name: str) -> None:
    decode = DecoderFactory().decoder_for(
        "cdr", Schema(1, message_definition(type_name).encode(), "ros2msg", type_name)
    )
    message = random_message(type_name, np.random.default_rng(7), is_tame=True)
    assert decode is not None
    assert decode(serialised(message)).header.frame_id == message.header.frame_id if "TF" not in type_name else True


def test_detection_is_52_bytes_and_a_list_holds_800() -> None:
    """Driver's own layout (ars548_ros): 41,741 bytes for a frame name of eleven characters."""
    message = random_message("ars548_messages/msg/DetectionList", np.random.default_rng(0))
    message.header.frame_id = "radar_front"
    assert len(serialised(message)) == 41_741


def test_a_type_that_nobody_described_is_refused() -> None:
    with pytest.raises(DefinitionMissingError, match=r"no definition of 'my_msgs/msg/Thing' is known"):
        message_definition("my_msgs/msg/Thing")


@pytest.mark.field_data
def test_our_novatel_fields_are_the_drivers(field_data: Path) -> None:
    """Names and order; the folder is of the older branch, whose differences are named."""
    folder = field_data / "novatel_oem7/novatel_oem7_msgs/msg"
    for name in (*OWN, "Oem7Header"):
        ours = [field for field, _kind in typestore().fielddefs[f"novatel_oem7_msgs/msg/{name}"][1]]
        lines = (line.split("#")[0].split() for line in (folder / f"{name}.msg").read_text().splitlines())
        theirs = [words[1] for words in lines if len(words) == 2 and "=" not in words[1]]
        extra = ["receiver_status", "idle_time"] if name == "Oem7Header" else []
        assert ours == theirs + extra
