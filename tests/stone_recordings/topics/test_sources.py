"""The topics that labelling takes are those whose messages say so, whatever the recorder's clock did."""

from pathlib import Path

import numpy as np
import pytest

from stone.geometry.se3 import SE3
from stone_recordings.bags.bag import open_bag
from stone_recordings.report.inspection import inspect
from stone_recordings.topics.sources import AskedTopics, choose_sources
from tests.stone_recordings.clocks.streams import MS
from tests.stone_recordings.rigs import odometry
from tests.stone_recordings.writing import (
    KITTI,
    POINT_CLOUD,
    START_NS,
    CloudText,
    Recorded,
    cloud_payload,
    sweep,
    write_mcap,
)

S = 1_000 * MS
FMCW = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("velocity", "<f4"), ("reflectivity", "<f4")])
JUMP_AT_NS = START_NS + 5 * S


def _clouds(
    topic: str, period_ns: int, points: int, jump_ns: int = 0, record: np.dtype[np.void] = KITTI
) -> list[Recorded]:
    """Ten seconds of them."""
    data = sweep(record, points)
    stamps_ns = range(START_NS, START_NS + 10 * S, period_ns)
    return [
        Recorded(
            topic, POINT_CLOUD, at + jump_ns * (at >= JUMP_AT_NS), cloud_payload(data, CloudText(at, frame_id=topic))
        )
        for at in stamps_ns
    ]


def _chosen(path: Path, *groups: list[Recorded]) -> tuple[str, str | None]:
    """The LiDAR that labelling takes and the one that inspection names."""
    poses = [odometry(START_NS + row * 50 * MS, SE3.identity()) for row in range(200)]
    write_mcap(path / "run.mcap", [message for group in (*groups, poses) for message in group])
    with open_bag(path / "run.mcap") as bag:
        labelled = choose_sources(bag, AskedTopics()).lidar.name
    return labelled, inspect(path / "run.mcap").assignment.channels.get("lidar")


@pytest.mark.parametrize("jump_s", [0, 70, -70, 3600])
def test_a_planar_scanner_is_not_taken_for_the_lidar_where_the_recorders_clock_jumped(
    tmp_path: Path, jump_s: int
) -> None:
    """Over a time that is 70 s too long the LiDAR's 10 Hz are 1.25, a map's, and the scanner's 50 Hz a LiDAR's."""
    rig = [_clouds(*kind, jump_s * S) for kind in (("/points", 100 * MS, 2000), ("/scan_cloud", 20 * MS, 541))]
    assert _chosen(tmp_path, *rig) == ("/points", "/points")


def test_a_lidar_that_measures_speed_is_the_lidar_beside_a_radar_that_does(tmp_path: Path) -> None:
    lidar = _clouds("/points", 100 * MS, 24_000, record=FMCW)
    radar = _clouds("/detections", 50 * MS, 300, record=FMCW)
    assert _chosen(tmp_path, lidar, radar) == ("/points", "/points")


def test_a_planar_scanner_alone_is_the_lidar(tmp_path: Path) -> None:
    assert _chosen(tmp_path, _clouds("/cloud", 20 * MS, 541)) == ("/cloud", "/cloud")


def test_what_an_empty_cloud_says_nothing_about_another_tells(tmp_path: Path) -> None:
    """The cloud in the middle, which is looked at first, has no points: no LiDAR's number, and no radar's."""
    lidar = _clouds("/points", 100 * MS, 24_000, record=FMCW)
    empty = cloud_payload(sweep(FMCW, 0), CloudText(START_NS + 5 * S, frame_id="/points"))
    lidar[50] = Recorded("/points", POINT_CLOUD, START_NS + 5 * S, empty)
    assert _chosen(tmp_path, lidar, _clouds("/detections", 50 * MS, 300, record=FMCW)) == ("/points", "/points")
