"""A topic's role follows from what it holds; its name only breaks ties."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from stone.geometry.se3 import SE3
from stone_recordings.bags.bag import open_bag
from stone_recordings.report.inspection import inspect
from stone_recordings.topics.roles import (
    INSPVAX,
    ROLE_OF_TYPE,
    TRANSFORMS,
    Role,
    TopicFacts,
    fullest,
    likely_lidars,
    role_of,
    with_plausible_rate,
)
from stone_recordings.topics.sources import AskedTopics, choose_sources
from tests.stone_recordings import writing
from tests.stone_recordings.clocks.streams import MS
from tests.stone_recordings.rigs import odometry

XYZ = frozenset({"x", "y", "z"})


def _cloud(name: str, fields: frozenset[str], count: int) -> Role:
    return role_of(TopicFacts(name, writing.POINT_CLOUD, 10.0, XYZ | fields, count))


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
        ({"velocity", "reflectivity", "intensity"}, 24_000, "lidar"),  # Aeva: it measures speed by frequency
        ({"doppler"}, 5_000, "lidar"),
        ({"Doppler", "power"}, 4_999, "radar"),
        ({"velocity", "snr"}, 24_000, "lidar"),
        ({"velocity", "snr"}, 200, "radar"),  # TI mmWave
        ({"velocity", "rcs"}, 24_000, "radar"),
        ({"vrad", "amplitude"}, 8, "radar"),  # SICK RMS: raw targets
        ({"vx", "vy", "vz", "objLen", "objId"}, 6, "radar"),  # SICK RMS: tracks
    ],
)
@pytest.mark.parametrize("name", ["/points", "/radar", "/lidar"])
def test_a_cloud_is_told_by_its_fields_and_size_whatever_its_name(name, fields, count, role):
    assert _cloud(name, frozenset(fields), count) == role


@pytest.mark.parametrize("count", [0, 541, 999])
def test_only_of_a_small_cloud_that_measures_neither_speed_nor_cross_section_is_the_name_asked(count: int) -> None:
    """541 points a message are a SICK LMS 111's."""
    assert _cloud("/front_radar/points", frozenset({"intensity"}), count) == "radar"
    assert _cloud("/cloud", frozenset({"intensity"}), count) == "lidar"


def test_types_transforms_and_packets_have_their_roles() -> None:
    for type_name, role in ROLE_OF_TYPE.items():
        assert role_of(TopicFacts("/x", type_name, 10.0)) == role
    assert role_of(TopicFacts("/lidar/points/camera", "std_msgs/msg/String", 10.0)) == "other"
    assert role_of(TopicFacts("/tf_static", TRANSFORMS, None)) == "tf_static"
    assert role_of(TopicFacts("/robot/tf_static", TRANSFORMS, 0.1)) == "tf_static"
    assert role_of(TopicFacts("/tf_static", TRANSFORMS, 50.0)) == "tf"
    assert role_of(TopicFacts("/tf", TRANSFORMS, None)) == "tf"
    packets = "nebula_msgs/msg/NebulaPackets"
    assert role_of(TopicFacts("/sensing/radar/front/nebula_packets", packets, 20.0)) == "radar"
    assert role_of(TopicFacts("/sensing/front/nebula_packets", packets, 20.0)) == "other"


def _as_cdr(cloud: Any) -> bytes:
    """A ROS 1 cloud as the message of today."""
    stamp_ns = cloud.header.stamp.sec * 10**9 + cloud.header.stamp.nanosec
    fields = [writing.made("sensor_msgs/msg/PointField", **vars(field)) for field in cloud.fields]
    own = {"header": writing.header(stamp_ns, cloud.header.frame_id), "fields": fields}
    return writing.serialised(writing.made(writing.POINT_CLOUD, **vars(cloud) | own))


@pytest.mark.field_data
def test_of_a_sick_rig_the_scanner_is_the_lidar_and_both_clouds_of_the_radar_are_radars(field_data, tmp_path):
    """`/cloud` of 541 points, and a radar's `/cloud_radar_rawtarget` and `/cloud_radar_track` of 8."""
    [source] = (field_data / "ros1" / "sick").glob("*.bag")
    with AnyReader([source]) as reader:
        clouds = [connection for connection in reader.connections if connection.msgtype == writing.POINT_CLOUD]
        messages = [
            writing.Recorded(
                connection.topic, writing.POINT_CLOUD, time_ns, _as_cdr(reader.deserialize(data, writing.POINT_CLOUD))
            )
            for connection, time_ns, data in reader.messages(clouds)
        ]
    inspection = inspect(writing.write_mcap(tmp_path / "sick.mcap", messages))
    roles = {part.topic.name: part.role for part in inspection.topics}
    assert roles == {"/cloud": "lidar", "/cloud_radar_rawtarget": "radar", "/cloud_radar_track": "radar"}
    assert inspection.assignment.channels["lidar"] == "/cloud"


@dataclass(frozen=True)
class Seen:
    type: str
    count: int
    rate_hz: float | None
    point_count: int = 0


def test_only_an_implausible_rate_rules_a_topic_out_and_never_the_last() -> None:
    sweeps, a_map, unknown = (Seen(writing.POINT_CLOUD, 10, rate_hz) for rate_hz in (10.0, 0.1, None))
    assert with_plausible_rate("lidar", [a_map, sweeps, unknown]) == [sweeps]
    assert with_plausible_rate("lidar", [a_map, unknown]) == [a_map, unknown]
    assert with_plausible_rate("odometry", [a_map, sweeps]) == [a_map, sweeps]


def test_a_cloud_of_few_points_is_the_lidar_only_where_there_is_no_fuller_one() -> None:
    sweeps, obstacles, plane = (Seen(writing.POINT_CLOUD, 10, 10.0, points) for points in (24_000, 40, 541))
    assert likely_lidars([obstacles, sweeps, plane]) == [sweeps]
    assert likely_lidars([plane]) == [plane]
    assert likely_lidars([]) == []
    assert likely_lidars([Seen(writing.POINT_CLOUD, 1, 0.1, 900_000), plane]) == [plane]


def test_of_two_logs_of_one_receiver_the_fuller_counts_and_then_the_one_with_its_quality() -> None:
    inspva = Seen("novatel_oem7_msgs/msg/INSPVA", 10, 10.0)
    fuller, equal = Seen(INSPVAX, 20, 20.0), Seen(INSPVAX, 10, 10.0)
    assert fullest([inspva, fuller]) == [fuller]
    assert fullest([inspva, equal]) == fullest([equal, inspva]) == [equal]
    assert fullest([equal, fuller]) == [equal, fuller]
    assert fullest([]) == []


S = 1_000 * MS
FMCW = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("velocity", "<f4"), ("reflectivity", "<f4")])
JUMP_AT_NS = writing.START_NS + 5 * S


def _clouds(
    topic: str, period_ns: int, points: int, jump_ns: int = 0, record: np.dtype[np.void] = writing.KITTI
) -> list[writing.Recorded]:
    """Ten seconds of them."""
    data = writing.sweep(record, points)
    stamps_ns = range(writing.START_NS, writing.START_NS + 10 * S, period_ns)
    return [
        writing.Recorded(
            topic,
            writing.POINT_CLOUD,
            at + jump_ns * (at >= JUMP_AT_NS),
            writing.cloud_payload(data, writing.CloudText(at, frame_id=topic)),
        )
        for at in stamps_ns
    ]


def _chosen(path: Path, *groups: list[writing.Recorded]) -> tuple[str, str | None]:
    """The LiDAR that labelling takes and the one that inspection names."""
    poses = [odometry(writing.START_NS + row * 50 * MS, SE3.identity()) for row in range(200)]
    writing.write_mcap(path / "run.mcap", [message for group in (*groups, poses) for message in group])
    with open_bag(path / "run.mcap") as bag:
        labelled = choose_sources(bag, AskedTopics()).lidar.name
    return labelled, inspect(path / "run.mcap").assignment.channels.get("lidar")


@pytest.mark.parametrize("jump_s", [0, 70, -70, 3600])
def test_a_planar_scanner_is_not_taken_for_the_lidar_where_the_recorders_clock_jumped(tmp_path, jump_s):
    """Over a time that is 70 s too long the LiDAR's 10 Hz are 1.25, a map's, and the scanner's 50 Hz a LiDAR's."""
    rig = [_clouds(*kind, jump_s * S) for kind in (("/points", 100 * MS, 2000), ("/scan_cloud", 20 * MS, 541))]
    assert _chosen(tmp_path, *rig) == ("/points", "/points")


def test_a_planar_scanner_is_the_lidar_where_it_is_alone_and_a_measurer_of_speed_beside_a_radar(tmp_path: Path) -> None:
    lidar = _clouds("/points", 100 * MS, 24_000, record=FMCW)
    radar = _clouds("/detections", 50 * MS, 300, record=FMCW)
    assert _chosen(tmp_path, lidar, radar) == ("/points", "/points")
    assert _chosen(tmp_path, _clouds("/cloud", 20 * MS, 541)) == ("/cloud", "/cloud")


def test_what_an_empty_cloud_says_nothing_about_another_tells(tmp_path: Path) -> None:
    """The cloud in the middle, which is looked at first, has no points: no LiDAR's number, and no radar's."""
    lidar = _clouds("/points", 100 * MS, 24_000, record=FMCW)
    empty = writing.cloud_payload(
        writing.sweep(FMCW, 0), writing.CloudText(writing.START_NS + 5 * S, frame_id="/points")
    )
    lidar[50] = writing.Recorded("/points", writing.POINT_CLOUD, writing.START_NS + 5 * S, empty)
    assert _chosen(tmp_path, lidar, _clouds("/detections", 50 * MS, 300, record=FMCW)) == ("/points", "/points")
