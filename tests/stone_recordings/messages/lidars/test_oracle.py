"""Packets of real sensors decode to what Nebula's own tests hold as truth; an OT128's cloud lies on our angles.

What was measured is recorded as properties of the tests.
"""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from stone_recordings.bags.bag import Bag, open_bag
from stone_recordings.messages.lidars.angles import AZIMUTH_DEG, ELEVATION_DEG
from stone_recordings.messages.sweep_clouds import packet_cloud, sweep_cloud
from tests.stone_recordings.messages.lidars.encoding import SentPacket, nebula_packets
from tests.stone_recordings.writing import START_NS

HESAI, VELODYNE = "nebula_packets/nebula_hesai", "nebula_packets/nebula_velodyne"
# Of one firing of 16 lasers; two are a block.
FIRING_NS, LAST_BLOCK = 55_296, 10


def pcd(folder: Path) -> NDArray[np.void]:
    """The points of the one .pcd below."""
    (path,) = folder.rglob("*.pcd")
    content = path.read_bytes()
    start = content.index(b"DATA binary\n") + len(b"DATA binary\n")
    names, kinds, sizes = (
        re.search(rf"{key} (.*)", content[:start].decode())[1].split()  # type: ignore[index]
        for key in ("FIELDS", "TYPE", "SIZE")
    )
    record = [(name, f"<{kind.lower()}{size}") for name, kind, size in zip(names, kinds, sizes, strict=True)]
    return np.frombuffer(content[start:], np.dtype(record))


def places(points: NDArray[np.void]) -> NDArray[np.float64]:
    return np.stack([points[axis] for axis in "xyz"], axis=1).astype(np.float64)


def recorded(folder: Path) -> Bag:
    return open_bag(next(folder.rglob("*.db3")).parent)


@pytest.mark.field_data
def test_every_point_of_a_pandar40p_is_within_a_hundredth_of_a_millimetre_of_the_truth(
    field_data: Path, record_property: Callable[[str, float], None]
) -> None:
    with recorded(field_data / HESAI) as bag:
        (topic,) = bag.topics
        clouds = [packet_cloud(message.payload, topic.type) for message in bag.messages(topic.name)]
    assert [(one.model, one.left_out) for one in clouds] == [("Pandar40P", 0)] * 4
    truth = places(pcd(field_data / HESAI))
    apart_mm = cKDTree(np.concatenate([places(one.cloud.points) for one in clouds])).query(truth)[0] * 1e3
    record_property("worst_mm", float(apart_mm.max()))
    assert len(truth) == 56_762
    assert apart_mm.max() < 0.01


@pytest.mark.field_data
def test_every_point_of_a_vlp16_is_at_the_range_of_its_laser_and_at_the_azimuth_of_the_truth(
    field_data: Path, record_property: Callable[[str, float], None]
) -> None:
    """Nebula rounds azimuths to 0.01°. It does not turn the last sequence of a packet, and of two returns puts the
    second where the next sequence began: azimuths of these are up to a sequence (0.4°) off, and left out.

    The times of this truth count from each packet anew, so they say which block a point is of and nothing more.
    """
    with recorded(field_data / VELODYNE) as bag:
        (topic,) = bag.topics
        points = np.concatenate([sweep_cloud(one.payload, topic.type).points for one in bag.messages(topic.name)])
    truth = pcd(field_data / VELODYNE)
    range_m = np.linalg.norm(places(points), axis=1)
    ours = np.stack([points["ring"] * 100.0, range_m * 1e3, np.rad2deg(np.angle(_bearing(points)))], axis=1)
    theirs = np.stack(
        [truth["channel"] * 100.0, truth["distance"] * 1e3, np.rad2deg(np.angle(_bearing(truth)))], axis=1
    )
    _apart, place = cKDTree(ours).query(theirs)
    assert len(truth) == 14_831
    assert np.array_equal(points["ring"][place], truth["channel"])
    block = truth["time_stamp"] // FIRING_NS // 2
    is_told = (block % 2 == 0) & (block < LAST_BLOCK)
    range_mm = np.abs(range_m[place] - truth["distance"]) * 1e3
    turn_mrad = np.abs(np.angle(_bearing(points)[place] / _bearing(truth))) * 1e3
    for name, value in (
        ("range_mm", range_mm.max()),
        ("turn_mrad", turn_mrad[is_told].max()),
        ("told", is_told.mean()),
    ):
        record_property(name, float(value))
    record_property("all_mrad", float(turn_mrad.max()))
    assert range_mm.max() < 0.01
    assert turn_mrad[is_told].max() < 0.1
    assert is_told.mean() > 0.75
    assert turn_mrad.max() < np.deg2rad(0.42) * 1e3


def _bearing(points: NDArray[np.void]) -> NDArray[np.complex128]:
    return np.asarray(points["x"] + 1j * points["y"].astype(np.float64))


def _which_return(key: NDArray[np.int64]) -> NDArray[np.int64]:
    """Of each key, how many times it was there before."""
    order = np.argsort(key, kind="stable")
    found = np.empty(len(key), np.int64)
    found[order] = np.arange(len(key)) - np.searchsorted(key[order], key[order])
    return found


@pytest.mark.field_data
def test_the_cloud_of_a_real_ot128_lies_on_our_angles_and_comes_back_from_packets(
    field_data: Path, record_property: Callable[[str, float], None]
) -> None:
    """Its packets were not to be had: elevations are those of the table, azimuths then hundredths of a degree and
    ranges steps of 4 mm, and packets that say so decode to the same points."""
    truth = places(pcd(field_data / "hesai_ot128"))
    range_m = np.linalg.norm(truth, axis=1)
    up_deg = np.rad2deg(np.arcsin(truth[:, 2] / range_m))
    laser = np.abs(up_deg[:, None] - ELEVATION_DEG["OT128"]).argmin(axis=1)
    assert np.abs(up_deg - ELEVATION_DEG["OT128"][laser]).max() < 5e-4
    hundredths = (np.rad2deg(np.arctan2(truth[:, 0], truth[:, 1])) - AZIMUTH_DEG["OT128"][laser]) * 100
    counts = range_m / 0.004
    record_property("azimuth_deg", float(np.abs(hundredths - hundredths.round()).max() / 100))
    assert np.abs(hundredths - hundredths.round()).max() < 0.1
    assert np.abs(counts - counts.round()).max() < 0.02
    azimuth = hundredths.round().astype(np.int64) % 36_000
    row_of = np.stack([azimuth, _which_return(azimuth * 128 + laser)], axis=1)
    rows, row = np.unique(row_of, axis=0, return_inverse=True)
    columns = np.append(rows[:, 0], rows[-1:, 0])  # a packet holds two
    table = np.zeros((len(columns), 128), np.int64)
    table[row.ravel(), laser] = counts.round()
    packets = [
        SentPacket("OT128", row * 55, columns[row : row + 2].tolist(), table[row : row + 2]).content
        for row in range(0, len(columns) - 1, 2)
    ]
    payload = nebula_packets(packets, [START_NS] * len(packets), START_NS)
    found = places(sweep_cloud(memoryview(payload), "nebula_msgs/msg/NebulaPackets").points)
    apart_mm = cKDTree(found).query(truth)[0] * 1e3
    record_property("worst_mm", float(apart_mm.max()))
    assert apart_mm.max() < 1.0
