"""Sweeps and radar scans of strangers, whatever numbers they hold: finite samples, without a warning."""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from services.labeler.exports.nuscenes.samples import RADAR_RECORD, lidar_bytes, radar_bytes
from services.labeler.exports.sandboxed_export import lidar_sample, radar_sample
from stone.geometry.se3 import SE3
from stone.sensors.radar_motion import RadarMotion
from stone.sensors.samples import LidarSample, RadarSample
from stone_exports.files import ExportFileSpan

STILL = RadarMotion(SE3.identity(), np.zeros(3))
ROWS = st.integers(0, 20)
ANY_FLOAT = st.floats(width=32)


def span_of(folder: str, content: bytes) -> ExportFileSpan:
    path = Path(folder) / "file"
    path.write_bytes(content)
    return ExportFileSpan(path, "samples/file", 0, len(content))


@given(ROWS.flatmap(lambda count: arrays("<f4", (count, 5), elements=ANY_FLOAT)))
def test_a_sweep_of_any_numbers_is_finite_points_that_are_written_again_as_they_are(rows: np.ndarray) -> None:
    with TemporaryDirectory() as folder:
        sample = lidar_sample(span_of(folder, rows.tobytes()))
        again = lidar_sample(span_of(folder, lidar_bytes(sample)))
    for values in (sample.points_lidar, sample.intensity, sample.ring):
        assert np.isfinite(values).all()
    assert (sample.points_lidar != 0).any(axis=1).all()
    assert lidar_bytes(again) == lidar_bytes(sample)


@example(np.frombuffer(b"\x01\0\x80\x7f" * 10 + bytes(3), np.uint8), "4")
@given(ROWS.flatmap(lambda count: arrays(np.uint8, count * RADAR_RECORD.itemsize)), st.sampled_from(["4", "8"]))
def test_a_scan_of_any_bytes_is_finite_detections(content: np.ndarray, size: str) -> None:
    """As nuScenes writes them, and of six numbers of eight bytes, which hold far larger and smaller ones."""
    records = np.frombuffer(content.tobytes(), RADAR_RECORD)
    blank = RadarSample(0, np.ones((1, 3)), np.ones((1, 3)), np.ones(1), np.ones(1), np.ones(1, np.float32))
    head = radar_bytes(blank).partition(b"DATA binary\n")[0].decode()
    head, width = head.replace("POINTS 1", f"POINTS {len(records)}"), len(content)
    if size == "8":
        names, count = "x y z rcs vx_comp vy_comp", width // 48
        head = f"FIELDS {names}\nSIZE 8 8 8 8 8 8\nTYPE F F F F F F\nPOINTS {count}\n"
    with TemporaryDirectory() as folder:
        span = span_of(folder, head.encode() + b"DATA binary\n" + content.tobytes() + b"\n")
        sample = radar_sample(span, 0, STILL)
    for values in (sample.points_radar, sample.points_lidar, sample.range_rate_m_s, sample.ground_rate_m_s):
        assert np.isfinite(values).all()
    assert np.isfinite(sample.rcs_db).all()


@given(st.lists(st.tuples(*[st.floats(-100, 100)] * 3, st.floats(-50, 50), st.floats(-50, 50)), max_size=20))
def test_a_scan_that_was_written_is_read_with_its_rates(detections: list[tuple[float, ...]]) -> None:
    """Where the ray leaves the vertical; straight up a velocity in plan says nothing of it."""
    found = np.array(detections, np.float64).reshape(-1, 5)
    found = found[np.linalg.norm(found[:, :2], axis=1) > 0.1]
    points, rate, ground = found[:, :3], found[:, 3], found[:, 4]
    written = RadarSample(0, points, points, rate, ground, np.zeros(len(found), np.float32))
    with TemporaryDirectory() as folder:
        sample = radar_sample(span_of(folder, radar_bytes(written)), 0, STILL)
    assert np.allclose(sample.points_radar, points, rtol=1e-6)
    assert np.allclose(sample.range_rate_m_s, rate, rtol=1e-4, atol=1e-5)
    assert np.allclose(sample.ground_rate_m_s, ground, rtol=1e-4, atol=1e-5)


def test_straight_up_there_is_no_rate() -> None:
    up = np.array([[0.0, 0.0, 5.0]])
    written = RadarSample(0, up, up, np.ones(1), np.ones(1), np.zeros(1, np.float32))
    with TemporaryDirectory() as folder:
        sample = radar_sample(span_of(folder, radar_bytes(written)), 0, STILL)
    assert (sample.range_rate_m_s.tolist(), sample.ground_rate_m_s.tolist()) == ([0.0], [0.0])


def test_a_sweep_whose_rings_are_no_rings_has_those_that_there_can_be() -> None:
    rows = np.array([[1, 2, 3, 4, -7], [1, 2, 3, 4, 7e9], [1, 2, 3, np.inf, np.nan]], "<f4")
    with TemporaryDirectory() as folder:
        sample = lidar_sample(span_of(folder, rows.tobytes()))
    assert sample.ring.tolist() == [0, 65535, 0]
    assert sample.intensity.tolist() == [4, 4, 0]
    assert isinstance(sample, LidarSample)
