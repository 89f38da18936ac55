"""Packets that the tests encode themselves decode to the points that were meant; hostile ones are refused."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from stone_recordings.bags.bag import Bag, open_bag
from stone_recordings.bags.errors import IngestError, MessageLayoutError
from stone_recordings.messages.errors import LidarPacketError
from stone_recordings.messages.lidars.models import LidarModel
from stone_recordings.messages.lidars.points import AZIMUTH_DEG, ELEVATION_DEG
from stone_recordings.messages.pointcloud2 import lidar_points
from stone_recordings.messages.sweep_clouds import packet_cloud, sweep_cloud, sweep_problem
from tests.stone_recordings.messages.lidars import encoding
from tests.stone_recordings.writing import START_NS

MODELS: tuple[LidarModel, ...] = ("VLP-16", "VLP-32C", "VLS-128", "Pandar40P", "OT128")
SCANS = {
    "velodyne_msgs/msg/VelodyneScan": encoding.velodyne_scan,
    "pandar_msgs/msg/PandarScan": encoding.pandar_scan,
    "nebula_msgs/msg/NebulaPackets": encoding.nebula_packets,
    "hesai_ros_driver/msg/UdpFrame": encoding.udp_frame,
}
NEBULA = "nebula_msgs/msg/NebulaPackets"
CYCLE_US = {"VLP-16": 1327, "VLP-32C": 664, "VLS-128": 160, "Pandar40P": 556, "OT128": 111}
STEP = 20


def pulses(model: str, mode: int) -> int:
    """Sequences of a packet, each of which turns by a step."""
    blocks = {"VLS-128": 8 if mode == encoding.DUAL else 12}.get(model, encoding.BLOCKS[model])
    return blocks // (2 if mode == encoding.DUAL else 1) // (4 if model == "VLS-128" else 1)


def sent(model: LidarModel, number: int, rng: np.random.Generator, mode: int = encoding.SINGLE) -> encoding.SentPacket:
    """The packet `number` of a sweep that began at 350°, with ranges drawn at random and some without return."""
    each = pulses(model, mode)
    blocks = range(encoding.BLOCKS[model])
    place = [number * each + min(each - 1, block * each // pulses_blocks(model, mode)) for block in blocks]
    shape = (encoding.BLOCKS[model], encoding.LASERS[model])
    echo = np.arange(shape[0])[:, None] % 2  # odd ranges of second returns: none repeats the first by chance
    counts = (2 * rng.integers(100, 10_000, shape) + echo) * (rng.random(shape) < 0.8)
    if model == "VLS-128" and mode == encoding.DUAL:
        counts[8:] = 0
    azimuth = [(35_000 + STEP * one) % 36_000 for one in place]
    return encoding.SentPacket(model, 999_500 + number * CYCLE_US[model], azimuth, counts, mode)


def pulses_blocks(model: str, mode: int) -> int:
    return 8 if model == "VLS-128" and mode == encoding.DUAL else encoding.BLOCKS[model]


@pytest.mark.whole
@pytest.mark.parametrize("mode", [encoding.SINGLE, encoding.DUAL])
@pytest.mark.parametrize("model", MODELS)
@given(seed=st.integers(0, 2**31), count=st.integers(2, 5))
@settings(max_examples=10)
def test_what_was_encoded_is_decoded_again(model: LidarModel, mode: int, seed: int, count: int) -> None:
    """Places to float32, times to the nanosecond; the microseconds of the sensor pass their second on the way."""
    rng = np.random.default_rng(seed)
    packets = [sent(model, number, rng, mode) for number in range(count)]
    stamps_ns = [START_NS + packet.time_us * 1000 - 999_500_000 for packet in packets]
    wrapped = packets if model in encoding.PRODUCTS else [wrapped_at_a_second(packet) for packet in packets]
    payload = encoding.nebula_packets([packet.content for packet in wrapped], stamps_ns, START_NS)
    points = sweep_cloud(memoryview(payload), NEBULA).points
    expected = np.array([point for packet in packets for point in encoding.meant(packet, STEP)])
    found = np.stack([points[axis] for axis in "xyz"] + [points["time_stamp"] / 1e3], axis=1).astype(np.float64)
    expected[:, 3] -= 999_500
    apart, place = cKDTree(found).query(expected)
    assert len(found) == len(expected) == len(set(place.tolist()))
    assert apart.max() < 2e-3  # 80 m in float32, or 2 ns


def wrapped_at_a_second(packet: encoding.SentPacket) -> encoding.SentPacket:
    return encoding.SentPacket(packet.model, packet.time_us % 1_000_000, packet.azimuth, packet.counts, packet.mode)


@pytest.mark.parametrize("type_name", SCANS)
def test_every_message_of_packets_gives_the_same_cloud(type_name: str) -> None:
    rng = np.random.default_rng(3)
    model: LidarModel = "VLP-16" if "velodyne" in type_name else "Pandar40P"
    packets = [sent(model, number, rng).content for number in range(3)]
    stamps_ns = [START_NS + number * 1000 * CYCLE_US[model] for number in range(3)]
    payload = SCANS[type_name](packets, stamps_ns, START_NS)
    found = packet_cloud(memoryview(payload), type_name)
    plain = packet_cloud(memoryview(encoding.nebula_packets(packets, stamps_ns, START_NS)), NEBULA)
    assert found.cloud.points.tobytes() == plain.cloud.points.tobytes()
    assert (found.model, found.packets, found.left_out, found.cloud.stamp_ns) == (model, 3, 0, START_NS)
    assert sweep_problem(memoryview(payload)[:8192], type_name) == ""


def test_a_second_return_that_repeats_the_first_counts_once() -> None:
    rng = np.random.default_rng(4)
    packet = sent("Pandar40P", 0, rng, encoding.DUAL)
    packet.counts[1::2] = packet.counts[::2]
    payload = encoding.nebula_packets([packet.content], [START_NS], START_NS)
    assert len(sweep_cloud(memoryview(payload), NEBULA).points) == np.count_nonzero(packet.counts[::2])


def test_jitter_of_arrival_does_not_move_points_in_time() -> None:
    rng = np.random.default_rng(5)
    packets = [sent("VLP-16", number, rng) for number in range(75)]
    late_ns = rng.integers(0, 3_000_000, 75)
    stamps_ns = [START_NS + number * 1_327_000 + int(late) for number, late in enumerate(late_ns)]
    payload = encoding.velodyne_scan([packet.content for packet in packets], stamps_ns, START_NS)
    points = lidar_points(sweep_cloud(memoryview(payload), "velodyne_msgs/msg/VelodyneScan"))
    assert points.time_meaning == "relative ns"
    assert points.offset_ns is not None
    expected_us = np.sort([point[3] for packet in packets for point in encoding.meant(packet, STEP)]) - 999_500
    apart_us = np.sort(points.offset_ns) / 1e3 - expected_us
    assert np.ptp(apart_us) < 0.01
    assert abs(apart_us[0] - np.median(late_ns) / 1e3) < 1.0


def test_packets_stamped_by_another_clock_than_the_message_give_no_times() -> None:
    rng = np.random.default_rng(6)
    packets = [sent("VLP-16", number, rng).content for number in range(75)]
    stamps_ns = [START_NS + 37 * 10**9 + number * 1_327_000 for number in range(75)]
    payload = encoding.velodyne_scan(packets, stamps_ns, START_NS)
    points = lidar_points(sweep_cloud(memoryview(payload), "velodyne_msgs/msg/VelodyneScan"))
    assert (points.time_meaning, points.offset_ns) == ("another clock", None)


def test_packets_of_something_else_are_left_out_and_counted() -> None:
    good = sent("OT128", 0, np.random.default_rng(7)).content
    others = [b"", b"\xff\xee" * 20, good[:-200], bytes(861)]
    payload = encoding.nebula_packets([good, *others], [START_NS] * 5, START_NS)
    found = packet_cloud(memoryview(payload), NEBULA)
    assert (found.packets, found.left_out, found.model) == (5, 4, "OT128")


@pytest.mark.parametrize(
    ("content", "named"),
    [
        (b"\xff\xee" + bytes(1203) + b"\x21", "Velodyne HDL-32E.*velodyne_points"),
        (b"\xff\xee" + bytes(1203) + b"\x77", "product 0x77"),
        (b"\xee\xff\x06\x01" + bytes(800), "Hesai PandarXT.*send_point_cloud_ros"),
        (b"\xee\xff\x09\x09" + bytes(800), "protocol 9.9"),
        (b"anything", "unknown sensor"),
    ],
)
def test_a_model_that_is_not_decoded_is_refused_by_name(content: bytes, named: str) -> None:
    payload = encoding.nebula_packets([content], [START_NS], START_NS)
    with pytest.raises(LidarPacketError, match=named):
        sweep_cloud(memoryview(payload), NEBULA)
    assert "decoded are VLP-16" in sweep_problem(memoryview(payload), NEBULA)


def test_no_packets_too_many_and_a_count_beyond_the_message_are_refused() -> None:
    with pytest.raises(LidarPacketError):
        sweep_cloud(memoryview(encoding.nebula_packets([], [], START_NS)), NEBULA)
    payload = bytearray(encoding.nebula_packets([b"x"], [START_NS], START_NS))
    at = payload.index(b"hesai") + 8
    payload[at : at + 4] = b"\xff\xff\xff\x7f"
    with pytest.raises(MessageLayoutError):
        sweep_cloud(memoryview(bytes(payload)), NEBULA)
    payload = encoding.nebula_packets([b"x"] * 10_001, [START_NS] * 10_001, START_NS)
    with pytest.raises(MessageLayoutError):
        sweep_cloud(memoryview(payload), NEBULA)


@pytest.mark.parametrize("model", MODELS)
@given(data=st.data())
@settings(max_examples=40)
def test_damaged_packets_are_decoded_or_refused(model: LidarModel, data: st.DataObject) -> None:
    rng = np.random.default_rng(8)
    content = bytearray(encoding.nebula_packets([sent(model, n, rng).content for n in range(2)], [1, 2], START_NS))
    for _ in range(data.draw(st.integers(1, 8))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    try:
        cloud = sweep_cloud(memoryview(bytes(content)), NEBULA)
    except IngestError:
        return
    assert len(cloud.points) <= 2 * encoding.BLOCKS[model] * encoding.LASERS[model]
    lidar_points(cloud)


def test_the_makers_angles_are_one_each_and_within_their_fields_of_view() -> None:
    limits = {
        "VLP-16": (-15, 15),
        "VLP-32C": (-25, 15),
        "VLS-128": (-25, 15),
        "Pandar40P": (-25, 15),
        "OT128": (-25, 15.2),
    }
    for model, (low, high) in limits.items():
        angles = ELEVATION_DEG[model]
        assert len(set(angles.tolist())) == len(angles)
        assert low <= angles.min() < low + 0.5
        assert high - 0.5 < angles.max() <= high


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
def test_every_point_of_a_pandar40p_is_within_a_hundredth_of_a_millimetre_of_the_truth(field_data, record_property):
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


@pytest.mark.whole
@pytest.mark.field_data
def test_the_cloud_of_a_real_ot128_lies_on_our_angles_and_comes_back_from_packets(field_data, record_property):
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
        encoding.SentPacket("OT128", row * 55, columns[row : row + 2].tolist(), table[row : row + 2]).content
        for row in range(0, len(columns) - 1, 2)
    ]
    payload = encoding.nebula_packets(packets, [START_NS] * len(packets), START_NS)
    found = places(sweep_cloud(memoryview(payload), "nebula_msgs/msg/NebulaPackets").points)
    apart_mm = cKDTree(found).query(truth)[0] * 1e3
    record_property("worst_mm", float(apart_mm.max()))
    assert apart_mm.max() < 1.0
