"""A topic that nobody describes is said; one that describes itself, or that is known, is not."""

from stone_recordings.bags.topic import Topic
from stone_recordings.messages.types.definition_checks import MOST_DEFINITIONS, definition_findings
from stone_recordings.messages.types.registry import message_definition

IMU = "sensor_msgs/msg/Imu"


def test_a_known_type_needs_no_definition_in_the_recording() -> None:
    """As in every .db3 of Humble."""
    topics = [Topic("/imu", IMU, 3, ""), Topic("/radar", "ars548_messages/msg/DetectionList", 3, "")]
    assert list(definition_findings(topics)) == []


def test_an_unknown_type_that_is_described_needs_none_either() -> None:
    assert list(definition_findings([Topic("/own", "acme_msgs/msg/Thing", 3, "uint32 count\nstring name\n")])) == []


def test_a_type_that_nobody_describes_is_said_with_what_is_known_and_what_to_do() -> None:
    (found,) = definition_findings([Topic("/imu", IMU, 3, ""), Topic("/own", "acme_msgs/msg/Thing", 3, "")])
    assert (found.code, found.severity, found.topic) == ("BAG-020", "warning", "/own")
    assert "'acme_msgs/msg/Thing'" in found.message
    assert "novatel_oem7_msgs" in found.message
    assert "Upload its .msg files, or record with -s mcap" in found.message


def test_a_topic_without_messages_or_of_another_encoding_is_left_alone() -> None:
    topics = [Topic("/own", "acme_msgs/msg/Thing", 0, ""), Topic("/pb", "acme.Thing", 5, "", "protobuf")]
    assert list(definition_findings(topics)) == []


def test_a_definition_that_differs_from_the_known_one_is_said() -> None:
    other = message_definition(IMU).replace("geometry_msgs/Vector3 angular_velocity", "float32[3] angular_velocity", 1)
    assert other != message_definition(IMU)
    (found,) = definition_findings([Topic("/imu", IMU, 3, other)])
    assert (found.code, found.topic) == ("MSG-309", "/imu")


def test_a_definition_that_is_none_is_refused_where_nothing_else_is_known() -> None:
    (found,) = definition_findings([Topic("/own", "acme_msgs/msg/Thing", 3, "this is { no definition")])
    assert (found.severity, found.topic) == ("warning", "/own")
    assert found.code.startswith("MSG-")


def test_of_endless_topics_the_first_are_looked_at_and_the_others_counted() -> None:
    topics = [Topic(f"/{row}", IMU, 1, "") for row in range(MOST_DEFINITIONS + 7)]
    (found,) = definition_findings(topics)
    assert (found.code, found.severity) == ("BAG-020", "info")
    assert "7 further topics" in found.message
