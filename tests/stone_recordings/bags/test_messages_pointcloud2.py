"""Clouds are views of what was recorded; points come out bit for bit, and a cloud that lies is refused."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from stone.sensors.reach import FARTHEST_POINT_M
from stone_recordings.bags.bag import open_bag
from stone_recordings.bags.errors import ByteOrderError, CloudLayoutError, MessageLayoutError
from stone_recordings.messages.point_times import HOUR_NS, UNTIMED, PointClock, PointTimes, offsets_from_values
from stone_recordings.messages.pointcloud2 import (
    Cloud,
    LidarPoints,
    decode_cloud,
    layout_problem,
    lidar_points,
    points_of_head,
)
from stone_recordings.messages.types.registry import typestore
from tests.stone_recordings.writing import HESAI, KITTI, NEBULA, POINT_CLOUD, START_NS, CloudText, cloud_payload, sweep

LAYOUTS = {"hesai": HESAI, "nebula": NEBULA, "kitti": KITTI}
layouts = st.sampled_from(sorted(LAYOUTS))
seeds = st.integers(0, 2**32 - 1)


def _cloud(points: NDArray[np.void], text: CloudText | None = None) -> Cloud:
    return decode_cloud(memoryview(cloud_payload(points, text)))


def _read(points: NDArray[np.void], text: CloudText | None = None) -> LidarPoints:
    return lidar_points(_cloud(points, text))


def _slow_points(points: NDArray[np.void]) -> list[int]:
    """Rows that are a return, one at a time."""
    rows = []
    for row, point in enumerate(points):
        xyz = [float(point[name]) for name in "xyz"]
        if all(np.isfinite(xyz)) and 0 < math.hypot(*xyz) <= FARTHEST_POINT_M:
            rows.append(row)
    return rows


def _slow_beyond(points: NDArray[np.void]) -> int:
    """How many are places, and too far."""
    places = [[float(point[name]) for name in "xyz"] for point in points]
    return sum(all(np.isfinite(xyz)) and math.hypot(*xyz) > FARTHEST_POINT_M for xyz in places)


@settings(max_examples=30)
@given(layout=layouts, seed=seeds, count=st.integers(0, 60), frame_id=st.text("abc/é", max_size=9))
def test_a_cloud_is_what_rosbags_reads(layout: str, seed: int, count: int, frame_id: str) -> None:
    record = LAYOUTS[layout]
    points = np.frombuffer(np.random.default_rng(seed).bytes(count * record.itemsize), record)
    payload = cloud_payload(points, CloudText(frame_id=frame_id))
    theirs = typestore().deserialize_cdr(payload, POINT_CLOUD)
    ours = decode_cloud(memoryview(payload))
    assert (ours.stamp_ns, ours.frame_id) == (START_NS, theirs.header.frame_id)
    assert ours.points.tobytes() == theirs.data.tobytes() == points.tobytes()
    assert ours.points.dtype == record


@settings(max_examples=40)
@given(layout=layouts, seed=seeds, count=st.integers(0, 60))
def test_points_are_the_non_zero_ones_in_reach_bit_for_bit(layout: str, seed: int, count: int) -> None:
    """Random bits hold every kind of NaN and infinity, and numbers of every size; zeros of both signs are put in."""
    record, generator = LAYOUTS[layout], np.random.default_rng(seed)
    points = np.frombuffer(generator.bytes(count * record.itemsize), record).copy()
    for name in "xyz":
        points[name][generator.random(count) < 0.4] = generator.choice([0.0, -0.0, np.nan, np.inf, 1.0])
    read = _read(points)
    expected = points[_slow_points(points)]
    assert read.points_lidar.dtype == np.float32
    for axis, name in enumerate("xyz"):
        assert read.points_lidar[:, axis].tobytes() == expected[name].tobytes()
    assert read.beyond == _slow_beyond(points)


def test_a_view_does_not_copy() -> None:
    payload = memoryview(cloud_payload(sweep(HESAI, 100)))
    assert np.shares_memory(decode_cloud(payload).points, np.frombuffer(payload, np.uint8))


def test_hesai_points_carry_the_offset_of_their_absolute_time_and_their_ring() -> None:
    """float64 seconds of today have a grain of 238 ns."""
    points = sweep(HESAI, 1000)
    points["x"][::7] = np.nan
    points["x"][3], points["y"][3], points["z"][3] = 0, 0, 0
    kept = _slow_points(points)
    read = _read(points)
    assert read.time_meaning == "absolute s"
    assert read.offset_ns is not None
    assert read.ring is not None
    assert np.abs(read.offset_ns - np.array(kept) * 100_000).max() < 240
    assert read.ring.tolist() == [row % 128 for row in kept]


def test_nebula_points_carry_nanoseconds_and_kitti_s_no_time() -> None:
    read = _read(sweep(NEBULA, 1000))
    assert read.time_meaning == "relative ns"
    assert read.offset_ns is not None
    assert read.offset_ns.tolist() == [row * 100_000 for row in range(1000)]
    read = _read(sweep(KITTI, 1000))
    assert (read.offset_ns, read.ring, read.time_meaning) == (None, None, "none")
    values = START_NS / 1e9 - 37 + np.arange(500) * 0.0002
    assert _times(values).meaning == "another clock"


@pytest.mark.parametrize(
    ("code", "scale", "is_absolute", "meaning"),
    [
        ("f4", 1.0, False, "relative s"), ("f8", 1.0, False, "relative s"), ("f4", 1e3, False, "relative ms"),
        ("f4", 1e6, False, "relative µs"), ("u4", 1e6, False, "relative µs"), ("u4", 1e9, False, "relative ns"),
        ("f8", 1e9, False, "relative ns"), ("f8", 1.0, True, "absolute s"), ("f8", 1e6, True, "absolute µs"),
        ("f8", 1e9, True, "absolute ns"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("name", ["t", "time", "timestamp", "time_stamp"])
def test_a_time_is_read_by_its_values_whatever_its_name(name, code, scale, is_absolute, meaning):
    points = np.zeros(500, np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), (name, f"<{code}")]))
    offset_s = np.arange(500) * 0.0002
    points["x"], points[name] = 1, (offset_s + (START_NS / 1e9 if is_absolute else 0)) * scale
    read = _read(points)
    assert read.time_meaning == meaning
    assert read.offset_ns is not None
    assert np.abs(read.offset_ns - offset_s * 1e9).max() < 1100


NUMBERLESS = [np.where(np.arange(9) < 5, bad, np.arange(9) * 0.01) for bad in (np.nan, np.inf, -np.inf)]


@pytest.mark.parametrize(
    "values", [np.zeros(9), np.full(9, START_NS / 1e9), np.arange(9) * 1e-9, np.arange(9) * 1e30, *NUMBERLESS]
)
def test_values_that_no_sweep_lasts_are_no_times(values: NDArray[np.float64]) -> None:
    found = _times(values)
    assert (found.offset_ns, found.meaning) == (None, "none")


def _times(values: NDArray[Any], stamp_ns: int = START_NS) -> PointTimes:
    return offsets_from_values(values, np.arange(len(values), dtype=np.int32), stamp_ns)


# A sweep of 3600 columns in storage order, and what a field holds of some of its points instead.
SPOILT = {
    "NaN": np.nan, "infinity": np.inf, "a date of nanoseconds": 1e18, "the largest": 1e299, "negative": -1e15,
    "another second": 1.3, "another unit": 50.0,
}  # fmt: skip


@settings(max_examples=60)
@given(
    kind=st.sampled_from(sorted(SPOILT)), seed=seeds, share=st.floats(0.001, 0.3),
    unit_ns=st.sampled_from([10**9, 10**6, 10**3, 1]), begin_ns=st.integers(-120_000_000, 30_000_000),
)  # fmt: skip
def test_a_few_bad_times_cost_only_their_points(kind, seed, share, unit_ns, begin_ns):
    """The rest are timed as without them; one between two good neighbours is timed within a column, or none is."""
    truth_ns = begin_ns + np.repeat(np.arange(360), 10) * 277_000.0
    is_bad = np.random.default_rng(seed).random(3600) < share
    values = np.where(is_bad, SPOILT[kind], truth_ns / 1e9) * (1e9 / unit_ns)
    found = _times(values)
    assert found.offset_ns is not None
    assert np.abs(found.offset_ns - truth_ns)[~is_bad].max() <= 1
    assert found.filled + found.untimed == is_bad.sum()
    told = is_bad & (found.offset_ns != UNTIMED)
    assert told.sum() == found.filled
    assert np.abs(found.offset_ns - truth_ns)[told].max(initial=0) < 10_000_000


def test_bad_times_of_points_in_no_order_are_dropped() -> None:
    rng = np.random.default_rng(1)
    values = rng.permutation(np.linspace(0, 0.1, 5000))
    values[:200] = np.nan
    found = _times(values)
    assert (found.filled, found.untimed) == (0, 200)
    assert found.offset_ns is not None
    assert (found.offset_ns[:200] == UNTIMED).all()


@pytest.mark.parametrize("begin_ns", [-50_000_000, -100_000_000, -137_216, 0])
@pytest.mark.parametrize("code", ["u4", "f8"])
def test_unsigned_times_below_the_stamp_are_negative(begin_ns: int, code: str) -> None:
    truth_ns = begin_ns + np.arange(0, 100_000_000, 100_000)
    found = _times(truth_ns.astype(np.uint32).astype(code))
    assert found.offset_ns is not None
    assert found.offset_ns.tolist() == truth_ns.tolist()
    assert (found.wrapped, found.untimed) == (int((truth_ns < 0).sum()), 0)


@settings(max_examples=60)
@given(
    stamp_ns=st.integers(2 * 10**9, 2 * 10**18),
    begin_ns=st.integers(-200_000_000, 100_000_000),
    unit_ns=st.sampled_from([10**9, 10**6, 10**3, 1]),
)
def test_absolute_times_are_read_at_any_date(stamp_ns: int, begin_ns: int, unit_ns: int) -> None:
    """A clock that was never set counts from 0; the grain is that of the field."""
    truth_ns = begin_ns + np.arange(0, 100_000_000, 100_000)
    values = (stamp_ns + truth_ns) / unit_ns
    found = _times(values, stamp_ns)
    assert found.offset_ns is not None
    assert np.abs(found.offset_ns - truth_ns).max() <= np.spacing(values[-1]) * unit_ns + 130


def test_microseconds_of_the_hour_are_read_across_its_end() -> None:
    stamp_ns = 1_700_002_800 * 10**9 - 40_000_000  # 40 ms before the hour
    truth_ns = np.arange(0, 100_000_000, 100_000)
    column = ((stamp_ns + truth_ns) // 1000 % 3_600_000_000).astype(np.uint32)
    rows = np.arange(len(column), dtype=np.int32)
    found = offsets_from_values(column, rows, stamp_ns, PointClock(0, HOUR_NS))
    assert found.offset_ns is not None
    assert found.offset_ns.tolist() == truth_ns.tolist()


def test_dates_in_four_bytes_are_named() -> None:
    assert _times((START_NS / 1e9 + np.arange(5000) * 2e-5).astype(np.float32)).meaning == "too coarse"


@pytest.mark.parametrize("zeros", [0.02, 0.2, 0.45])
def test_zeros_among_relative_times_are_none(zeros: float) -> None:
    truth_ns = np.repeat(np.arange(360), 10) * 277_000
    is_zero = np.random.default_rng(3).random(3600) < zeros
    found = _times(np.where(is_zero, 0, truth_ns).astype(np.uint32))
    assert found.offset_ns is not None
    assert np.abs(found.offset_ns - truth_ns)[found.offset_ns != UNTIMED].max() < 10_000_000
    assert found.filled + found.untimed > 0.7 * (is_zero & (truth_ns > 10_000_000)).sum()


def test_a_ring_is_a_small_whole_number_whatever_its_name() -> None:
    for name, code in (("ring", "u1"), ("channel", "<u2"), ("laser_id", "<u4"), ("line", "<f4")):
        points = np.zeros(200, np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), (name, code)]))
        points["x"], points[name] = 1, np.arange(200) % 128
        ring = _read(points).ring
        assert ring is not None
        assert ring.tolist() == [row % 128 for row in range(200)]
        points[name] = 5000 if code != "u1" else 255
        ring = _read(points).ring
        assert (ring is None) == (code != "u1")


def test_double_coordinates_are_rounded_once() -> None:
    record = np.dtype([("x", "<f8"), ("y", "<f8"), ("z", "<f8")])
    points = np.zeros(4, record)
    points["x"] = [1 / 3, 0, np.nan, 1e300]
    read = _read(points)
    assert (read.points_lidar.tolist(), read.beyond) == ([[np.float32(1 / 3), 0, 0]], 1)


@pytest.mark.parametrize("code", ["<f4", "<f8"])
def test_what_no_lidar_sees_is_no_point_and_is_counted(code: str) -> None:
    """Driver's words for no return, NaN and infinity, are counted as that."""
    record = np.dtype([(name, code) for name in "xyz"])
    points = np.ones(8, record)
    points["x"] = [999.9, 1000.1, 3e38, -3e38, np.inf, -np.inf, np.nan, 1.0]
    points["y"][7] = -2000.0
    read = _read(points)
    assert (read.rows.tolist(), read.beyond) == ([0], 4)


def test_padded_rows_are_skipped_over() -> None:
    """Two rows of three points, four bytes of padding behind each."""
    points = sweep(KITTI, 6)
    rows = [points[:3].tobytes() + b"junk", points[3:].tobytes() + b"junk"]
    payload = cloud_payload(points, CloudText(height=2, width=3, row_step=52))
    length_at = payload.index(points.tobytes()) - 4
    padded = payload[:length_at] + (104).to_bytes(4, "little") + b"".join(rows) + b"\x00"
    assert decode_cloud(memoryview(padded)).points.tobytes() == points.tobytes()


REFUTED = {
    "a step of nothing": CloudText(point_step=0), "a step of gigabytes": CloudText(point_step=0xFFFFFFFF),
    "a step larger than the data": CloudText(point_step=2600), "a row of nothing": CloudText(row_step=0),
    "a step smaller than its places": CloudText(point_step=10), "a row of half": CloudText(row_step=130),
    "a row of points": CloudText(row_step=10), "a row of one more": CloudText(row_step=261),
    "a row of gigabytes": CloudText(row_step=0xFFFFFFFF), "more points than data": CloudText(width=11, row_step=286),
    "fewer points than data": CloudText(width=9, row_step=234), "one point": CloudText(width=1),
    "fewer points in a row as long": CloudText(width=9, row_step=260), "no points": CloudText(width=0, row_step=0),
    "no steps": CloudText(point_step=0, row_step=0), "no rows": CloudText(height=0, width=10),
    "more rows": CloudText(height=4_000_000_000, width=10, row_step=260),
    "rows of columns": CloudText(height=5, width=2, row_step=130), "two wrong": CloudText(width=3, row_step=0),
}  # fmt: skip


@pytest.mark.parametrize("lie", REFUTED)
def test_a_size_that_the_bytes_refute_is_ignored_and_named(lie: str) -> None:
    points = sweep(HESAI, 10)
    cloud = _cloud(points, REFUTED[lie])
    assert cloud.points.tobytes() == points.tobytes()
    assert cloud.ignored


def test_a_field_that_no_bytes_hold_costs_itself() -> None:
    """An unknown type of the intensity; a second field of a name."""
    payload = cloud_payload(sweep(KITTI, 10))
    datatype = payload.index(b"intensity\0") + 16
    cloud = decode_cloud(memoryview(payload[:datatype] + b"\x0c" + payload[datatype + 1 :]))
    assert (cloud.points.dtype.names, "intensity" in cloud.ignored) == (("x", "y", "z"), True)


@settings(max_examples=300)
@example(height=2, width=1, point_step=52, row_step=130, count=10)  # rows with padding that fill the data
@given(
    height=st.sampled_from([0, 1, 2, 5, 10, 2**32 - 1]), width=st.sampled_from([0, 1, 2, 5, 9, 10, 11, 2**32 - 1]),
    point_step=st.sampled_from([0, 1, 12, 25, 26, 27, 52, 65536, 65537, 2**32 - 1]),
    row_step=st.sampled_from([0, 1, 10, 26, 52, 130, 259, 260, 261, 520, 2**32 - 1]), count=st.sampled_from([0, 1, 10]),
)  # fmt: skip
def test_the_head_of_a_cloud_is_refused_if_and_only_if_the_cloud_is(height, width, point_step, row_step, count):
    said = CloudText(height=height, width=width, point_step=point_step, row_step=row_step)
    payload = memoryview(cloud_payload(sweep(HESAI, count), said))
    problem = layout_problem(payload[:300], lambda: len(payload))
    try:
        cloud = decode_cloud(payload)
    except (CloudLayoutError, MessageLayoutError):
        assert problem
        return
    assert not problem
    assert points_of_head(payload[:300]) == len(cloud.points)
    assert cloud.points.nbytes <= 26 * count
    is_padded = height * row_step == 26 * count and row_step >= width * point_step
    assert cloud.ignored or height * width * point_step == 26 * count or is_padded or not count


LIES = {
    "a step smaller than its fields": CloudText(point_step=12, row_step=120),
    "data of another step": CloudText(point_step=27, row_step=270),
    "more points and rows than data": CloudText(height=3, width=7, row_step=7),
    "a field beyond the point": CloudText(offset_of_x=23),
    "a field beyond everything": CloudText(offset_of_x=0xFFFFFFFF),
    "a datatype that is none": CloudText(datatype_of_x=9), "x as an integer": CloudText(datatype_of_x=6),
}  # fmt: skip


@pytest.mark.parametrize("lie", LIES)
def test_a_cloud_that_lies_is_refused(lie: str) -> None:
    with pytest.raises(CloudLayoutError) as caught:
        _read(sweep(HESAI, 10), LIES[lie])
    assert caught.value.code == "MSG-303"


@pytest.mark.parametrize("record", [HESAI, NEBULA, KITTI])
@pytest.mark.parametrize("height", [1, 4])
def test_a_big_endian_cloud_holds_the_same_points(record: np.dtype[np.void], height: int) -> None:
    points = sweep(record, 400)
    plain = cloud_payload(points, CloudText(height=height))
    swapped = cloud_payload(points.astype(record.newbyteorder(">")), CloudText(height=height, is_bigendian=True))
    assert swapped != plain
    cloud, expected = (decode_cloud(memoryview(payload)) for payload in (swapped, plain))
    assert cloud.points.dtype == expected.points.dtype
    assert not cloud.is_misdeclared
    for name in record.names or ():
        np.testing.assert_array_equal(cloud.points[name], expected.points[name])
    ours, theirs = lidar_points(cloud), lidar_points(expected)
    np.testing.assert_array_equal(ours.points_lidar, theirs.points_lidar)
    np.testing.assert_array_equal(ours.rows, theirs.rows)
    assert ours.time_meaning == theirs.time_meaning
    for one, other in ((ours.offset_ns, theirs.offset_ns), (ours.ring, theirs.ring)):
        assert (one is None) == (other is None)
        assert one is None or np.array_equal(one, other)


def test_a_big_endian_cloud_is_read_as_numpy_reads_it_be_it_so_or_only_said() -> None:
    """An independent reading: the bytes of one field, as the standard says."""
    points = sweep(HESAI, 50).astype(HESAI.newbyteorder(">"))
    cloud = _cloud(points, CloudText(is_bigendian=True))
    raw = np.frombuffer(points.tobytes(), np.uint8).reshape(50, HESAI.itemsize)
    np.testing.assert_array_equal(cloud.points["timestamp"], raw[:, 18:26].copy().view(">f8")[:, 0])
    np.testing.assert_array_equal(cloud.points["ring"], raw[:, 16:18].copy().view(">u2")[:, 0])
    points = sweep(HESAI, 300)
    cloud = _cloud(points, CloudText(is_bigendian=True))
    assert cloud.is_misdeclared
    assert cloud.points.tobytes() == points.tobytes()


def test_a_cloud_without_coordinates_is_refused_and_padding_or_a_field_twice_is_not() -> None:
    with pytest.raises(CloudLayoutError):
        _read(np.zeros(3, np.dtype([("range", "<f4")])))
    payload = cloud_payload(np.zeros(3, np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("q", "<f4")])))
    name = b"\x02\x00\x00\x00q\x00"
    twice = decode_cloud(memoryview(payload.replace(name, b"\x02\x00\x00\x00x\x00")))
    assert (twice.points.dtype.names, twice.ignored) == (("x", "y", "z"), "a second field 'x'")
    assert decode_cloud(memoryview(payload.replace(name, b"\x02\x00\x00\x00_\x00"))).points.dtype.names == (
        "x",
        "y",
        "z",
    )


@settings(max_examples=100)
@given(layout=layouts, ratio=st.floats(0, 1, exclude_max=True), junk=st.binary(max_size=8), is_cut=st.booleans())
def test_a_damaged_cloud_is_read_or_refused_by_code(layout: str, ratio: float, junk: bytes, is_cut: bool) -> None:
    whole = cloud_payload(sweep(LAYOUTS[layout], 5))
    at = int(ratio * len(whole))
    damaged = whole[:at] + junk + (b"" if is_cut else whole[at + len(junk) :])
    try:
        read = lidar_points(decode_cloud(memoryview(damaged)))
    except (MessageLayoutError, CloudLayoutError, ByteOrderError):
        return
    assert np.isfinite(read.points_lidar).all()


@pytest.mark.field_data
def test_real_clouds_are_what_rosbags_reads(field_data: Path) -> None:
    with open_bag(field_data / "kitti0005_ros2_mcap/kitti0005_fullres_1s.mcap") as bag:
        for message in bag.messages("/velodyne_points"):
            theirs = typestore().deserialize_cdr(message.payload, POINT_CLOUD)
            ours = decode_cloud(message.payload)
            assert ours.points.tobytes() == theirs.data.tobytes()
            xyz = theirs.data.view(np.float32).reshape(-1, 4)[:, :3]
            assert lidar_points(ours).points_lidar.tobytes() == xyz[(xyz != 0).any(axis=1)].tobytes()
