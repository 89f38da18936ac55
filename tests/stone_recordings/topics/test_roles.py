"""A topic's role follows from what it holds; its name only breaks ties."""

from dataclasses import dataclass

import pytest

from stone_recordings.topics.roles import (
    INSPVAX,
    POINT_CLOUD,
    ROLE_OF_TYPE,
    TRANSFORMS,
    Role,
    TopicFacts,
    fullest,
    role_of,
    with_plausible_rate,
)

XYZ = frozenset({"x", "y", "z"})


def _cloud(name: str, fields: frozenset[str], count: int) -> Role:
    return role_of(TopicFacts(name, POINT_CLOUD, 10.0, XYZ | fields, count))


@pytest.mark.parametrize(
    ("fields", "count", "role"),
    [
        ({"intensity", "ring", "timestamp"}, 230_400, "lidar"),
        ({"intensity", "return_type", "channel", "azimuth", "elevation", "distance", "time_stamp"}, 200_000, "lidar"),
        ({"intensity"}, 24_740, "lidar"),
        ({"intensity", "ring"}, 300, "lidar"),
        ({"ring", "v"}, 50_000, "lidar"),
        ({"v", "r", "RCS", "azimuth", "elevation"}, 400, "radar"),
        ({"range_rate", "rcs"}, 4_000, "radar"),
        ({"intensity"}, 400, "radar"),
    ],
)
@pytest.mark.parametrize("name", ["/points", "/radar", "/lidar"])
def test_a_cloud_is_told_by_its_fields_and_size_whatever_its_name(
    name: str, fields: set[str], count: int, role: Role
) -> None:
    assert _cloud(name, frozenset(fields), count) == role


def test_only_of_an_empty_cloud_is_the_name_asked() -> None:
    assert _cloud("/front_radar/points", frozenset(), 0) == "radar"
    assert _cloud("/points", frozenset(), 0) == "lidar"


def test_every_known_type_has_its_role_and_others_are_other() -> None:
    for type_name, role in ROLE_OF_TYPE.items():
        assert role_of(TopicFacts("/x", type_name, 10.0)) == role
    assert role_of(TopicFacts("/lidar/points/camera", "std_msgs/msg/String", 10.0)) == "other"


def test_transforms_are_static_when_they_are_latched_under_the_contracted_name() -> None:
    assert role_of(TopicFacts("/tf_static", TRANSFORMS, None)) == "tf_static"
    assert role_of(TopicFacts("/robot/tf_static", TRANSFORMS, 0.1)) == "tf_static"
    assert role_of(TopicFacts("/tf_static", TRANSFORMS, 50.0)) == "tf"
    assert role_of(TopicFacts("/tf", TRANSFORMS, None)) == "tf"


def test_packets_that_either_sensor_sends_are_a_radar_s_only_where_the_name_says_so() -> None:
    packets = "nebula_msgs/msg/NebulaPackets"
    assert role_of(TopicFacts("/sensing/radar/front/nebula_packets", packets, 20.0)) == "radar"
    assert role_of(TopicFacts("/sensing/front/nebula_packets", packets, 20.0)) == "other"


@dataclass(frozen=True)
class Seen:
    type: str
    count: int
    rate_hz: float | None


def test_only_an_implausible_rate_rules_a_topic_out_and_never_the_last() -> None:
    sweeps, a_map, unknown = (Seen(POINT_CLOUD, 10, rate_hz) for rate_hz in (10.0, 0.1, None))
    assert with_plausible_rate("lidar", [a_map, sweeps, unknown]) == [sweeps]
    assert with_plausible_rate("lidar", [a_map, unknown]) == [a_map, unknown]
    assert with_plausible_rate("odometry", [a_map, sweeps]) == [a_map, sweeps]


def test_of_two_logs_of_one_receiver_the_fuller_counts_and_then_the_one_with_its_quality() -> None:
    inspva = Seen("novatel_oem7_msgs/msg/INSPVA", 10, 10.0)
    fuller, equal = Seen(INSPVAX, 20, 20.0), Seen(INSPVAX, 10, 10.0)
    assert fullest([inspva, fuller]) == [fuller]
    assert fullest([inspva, equal]) == fullest([equal, inspva]) == [equal]
    assert fullest([equal, fuller]) == [equal, fuller]
    assert fullest([]) == []
