"""A topic's role follows from what it holds; its name only breaks ties."""

import pytest

from services.ingest.roles import POINT_CLOUD, ROLE_OF_TYPE, TRANSFORMS, Role, TopicFacts, role_of

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
