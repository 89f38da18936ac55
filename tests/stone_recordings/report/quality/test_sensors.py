"""What is measured of pictures, clouds and positions, against slow loops and recordings of known quality."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, laplace

from simulator.options import SimulateOptions
from simulator.pipeline import simulate
from stone_recordings.report.inspection import Inspection
from stone_recordings.report.quality.coverage import COVER_BINS, covered_bins, covered_ratio, rates
from stone_recordings.report.quality.report import WORD_OF_TYPE, Quality, picture_facts, sharpness
from tests.stone_recordings.report.quality import recordings
from tests.stone_recordings.report.quality.recordings import LIDAR, RADAR, measured, ticks
from tests.stone_recordings.rigs import stamped, written
from tests.stone_recordings.writing import HESAI, Recorded, cloud_payload, header, random_message, serialised, sweep

DETECTION_LIST = "ars548_messages/msg/DetectionList"
SHAPES = st.tuples(st.integers(1, 12), st.integers(1, 12))


def detection_list(stamp_ns: int, count: int) -> Recorded:
    """Valid detections in every place, of which the list says that `count` count."""
    message = random_message(DETECTION_LIST, np.random.default_rng(count), True)
    message.header, message.list_numofdetections = header(stamp_ns, "radar"), count
    for detection in message.list_detections:
        detection.u_invalidflags = 0
    return Recorded(RADAR, DETECTION_LIST, stamp_ns, serialised(message))


@given(shape=SHAPES, seed=st.integers(0, 2**31))
def test_sharpness_is_the_variance_of_scipys_laplacian_inside(shape: tuple[int, int], seed: int) -> None:
    luminance = np.random.default_rng(seed).uniform(0, 255, shape).astype(np.float32)
    inside = laplace(luminance.astype(np.float64))[1:-1, 1:-1]
    assert sharpness(luminance) == pytest.approx(np.var(inside) if inside.size else 0.0, rel=1e-4, abs=1e-3)


def test_a_blurred_picture_is_less_sharp_and_as_bright() -> None:
    picture = np.random.default_rng(1).integers(0, 256, (80, 120, 3)).astype(np.uint8)
    blurred = gaussian_filter(picture, (2, 2, 0))
    sharp, soft = (picture_facts(pixels, (120, 80)) for pixels in (picture, blurred))
    assert soft.sharpness < sharp.sharpness / 50
    assert soft.brightness_ratio == pytest.approx(sharp.brightness_ratio, abs=0.01)


@pytest.mark.parametrize(("level", "dark", "bright"), [(0, 1.0, 0.0), (8, 1.0, 0.0), (128, 0.0, 0.0), (255, 0.0, 1.0)])
def test_flat_pictures_are_known_by_their_level(level: int, dark: float, bright: float) -> None:
    facts = picture_facts(np.full((9, 16, 3), level, np.uint8), (1600, 900))
    assert facts.size_px == (1600, 900)
    assert (facts.sharpness, facts.dark_ratio, facts.bright_ratio) == (pytest.approx(0, abs=1e-6), dark, bright)
    assert facts.brightness_ratio == pytest.approx(level / 255)


def test_cameras_are_named_by_their_place_and_measured_at_full_size(tmp_path: Path) -> None:
    topics = ("/camera/back/image", "/camera/front_left/image", "/webcam")
    path = written(tmp_path / "run.mcap", *(recordings.pictures(topic, ticks(2, 5)) for topic in topics))
    _, quality = measured(path)
    assert [camera.channel for camera in quality.facts.cameras] == ["CAM_FRONT_LEFT", "CAM_BACK", ""]
    for camera in quality.facts.cameras:
        assert camera.size_px == (96, 60)
        assert len(camera.at_ns) == len(camera.sharpness) == 10
        assert camera.brightness_ratio == pytest.approx([0.5] * 10, abs=0.02)


def test_zeros_in_a_cloud_and_detections_beyond_the_count_are_not_counted(tmp_path: Path) -> None:
    path = written(tmp_path / "run.mcap", recordings.clouds(ticks(2, 10), valid=900, count=1200))
    (lidar,) = measured(path)[1].facts.lidars
    assert (lidar.topic, set(lidar.slots)) == (LIDAR, {1200})
    assert lidar.valid_ratio == pytest.approx([0.75] * len(lidar.at_ns))
    assert all(10 < range_m < 60 for range_m in lidar.range_m)
    counts, stamps = (0, 3, 800, 7), ticks(0.2, 20)
    said = [detection_list(int(stamp), count) for stamp, count in zip(stamps, counts, strict=True)]
    (radar,) = measured(written(tmp_path / "run.mcap", said))[1].facts.radars
    assert (radar.topic, radar.detections) == (RADAR, counts)


@pytest.mark.parametrize("value", [np.inf, -np.inf, 3e38, np.nan])
def test_points_beyond_all_measure_stay_numbers(tmp_path: Path, value: float) -> None:
    stamps = ticks(1, 10)
    points = sweep(HESAI, 1200)
    points["y"] = value
    payload = cloud_payload(points)
    said = [Recorded(LIDAR, "sensor_msgs/msg/PointCloud2", int(stamp), payload) for stamp in stamps]
    record = measured(written(tmp_path / "run.mcap", said))[1].as_record()
    json.dumps(record, allow_nan=False)


def test_the_share_of_fixed_solutions_is_that_of_the_messages(tmp_path: Path) -> None:
    fixed, floating = recordings.solutions(ticks(6, 20), 56), recordings.solutions(ticks(2, 20, start_s=6.0), 55)
    path = written(tmp_path / "run.mcap", fixed, floating)
    rtk = measured(path)[1].facts.rtk
    assert rtk is not None
    assert (rtk.share("fixed"), rtk.share("float"), rtk.share("other")) == (0.75, 0.25, 0.0)
    assert list(rtk.words) == ["fixed"] * 120 + ["float"] * 40
    assert [WORD_OF_TYPE.get(kind, "other") for kind in (50, 56, 34, 55, 16, 53, 69)] == [
        "fixed", "fixed", "float", "float", "other", "other", "other",
    ]  # fmt: skip


def test_a_topic_that_lies_is_left_out_with_its_reason_and_the_others_are_measured(tmp_path: Path) -> None:
    stamps = ticks(2, 10)
    lies = [recordings.picture("/camera/front/image", int(stamp), b"\xff\xd8\xff no picture") for stamp in stamps]
    path = written(tmp_path / "run.mcap", lies, recordings.pictures("/camera/back/image", stamps))
    _, quality = measured(path)
    assert [camera.topic for camera in quality.facts.cameras] == ["/camera/back/image"]
    (finding,) = quality.left_out
    assert (finding.topic, finding.severity) == ("/camera/front/image", "error")
    assert any(deduction.code == finding.code for deduction in quality.deductions)


def test_what_the_inspection_named_already_is_not_said_again(tmp_path: Path) -> None:
    said = [
        Recorded(LIDAR, "sensor_msgs/msg/PointCloud2", int(stamp), b"\0\1\0\0" + bytes(40)) for stamp in ticks(1, 10)
    ]
    inspection, quality = measured(written(tmp_path / "run.mcap", said))
    named = [finding.code for finding in (*inspection.findings, *quality.left_out) if finding.topic == LIDAR]
    assert len(named) == len(set(named)) >= 1
    assert quality.facts.lidars == ()


def test_a_recording_of_one_message_or_none_has_a_quality_too(tmp_path: Path) -> None:
    path = written(tmp_path / "run.mcap", [])
    _, quality = measured(path)
    assert (quality.facts.coverage, quality.facts.cameras, quality.facts.rtk) == ((), (), None)
    assert {deduction.code for deduction in quality.deductions} == {"TOP-101", "TOP-103"}
    path = written(tmp_path / "run.mcap", [stamped("/imu", "sensor_msgs/msg/Imu", 10**18, "imu")])
    (topic,) = measured(path)[1].facts.coverage
    assert (topic.covered_ratio, topic.covered, topic.rates_hz) == (None, (), ())


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> tuple[Inspection, Quality]:
    path = tmp_path_factory.mktemp("clean") / "run.mcap"
    simulate(
        path,
        SimulateOptions(
            seconds=1.5, channels=16, columns=180, camera_width_px=64, world_width_m=40.0, host_delay_max_ns=0
        ),
    )
    return measured(path)


def test_of_a_clean_drive_every_sensor_is_measured_and_the_score_nearly_full(clean: tuple[Inspection, Quality]) -> None:
    inspection, quality = clean
    assert inspection.findings == ()
    assert quality.score >= 95, quality.deductions
    assert quality.left_out == ()
    facts = quality.facts
    assert {topic.topic for topic in facts.coverage} == {topic.topic.name for topic in inspection.topics}
    assert [camera.channel for camera in facts.cameras] == [
        "CAM_FRONT_LEFT", "CAM_FRONT", "CAM_FRONT_RIGHT", "CAM_BACK_LEFT", "CAM_BACK", "CAM_BACK_RIGHT",
    ]  # fmt: skip
    assert len(facts.lidars) == 1
    assert [min(radar.detections) > 0 for radar in facts.radars] == [True] * 3
    assert facts.rtk is not None
    assert facts.rtk.share("fixed") == 1.0
    for topic in facts.coverage:
        assert topic.role == "tf_static" or topic.covered_ratio == pytest.approx(1.0), topic


S = 1_000_000_000
STEPS = st.lists(st.integers(1_000_000, 3 * S), min_size=4, max_size=80)


def every(period_s: float, start_s: float, stop_s: float) -> NDArray[np.int64]:
    return (np.arange(start_s, stop_s, period_s) * S).astype(np.int64)


def test_a_topic_is_covered_but_for_its_pauses() -> None:
    times = every(0.1, 0.0, 20.05)
    assert covered_ratio(times, 20 * S, S // 4) == 1.0
    assert covered_bins(times, 20 * S, S // 4) == pytest.approx(1.0)
    times = np.concatenate([every(0.1, 0.0, 8.05), every(0.1, 12.0, 20.05)])
    assert covered_ratio(times, 20 * S, S // 4) == pytest.approx(0.8)
    bins = covered_bins(times, 20 * S, S // 4)
    assert bins.mean() == pytest.approx(0.8)
    assert (bins[33:47] == 0).all()
    assert bins[:31] == pytest.approx(1.0)
    assert bins[49:] == pytest.approx(1.0)


@pytest.mark.parametrize(("start_s", "stop_s", "ratio"), [(0.9, 19.1, 1.0), (5.0, 20.05, 0.75), (0.0, 10.05, 0.5)])
def test_starting_late_by_a_second_costs_nothing_and_by_more_costs_all_of_it(start_s, stop_s, ratio):
    assert covered_ratio(every(0.1, start_s, stop_s), 20 * S, S // 4) == pytest.approx(ratio, abs=0.01)


@given(steps=STEPS, longest_ns=st.integers(1_000_000, 2 * S), head=st.integers(0, 5 * S), tail=st.integers(0, 5 * S))
def test_bins_add_up_to_the_covered_steps(steps: list[int], longest_ns: int, head: int, tail: int) -> None:
    times = np.cumsum([head, *steps]).astype(np.int64)
    span_ns = int(times[-1]) + tail
    bins = covered_bins(times, span_ns, longest_ns)
    assert bins.shape == (COVER_BINS,)
    assert ((bins >= 0) & (bins <= 1)).all()
    covered_ns = sum(step for step in steps if step <= longest_ns)
    assert bins.sum() * span_ns / COVER_BINS == pytest.approx(covered_ns, rel=1e-9, abs=1.0)
    assert 0 <= covered_ratio(times, span_ns, longest_ns) <= 1


@pytest.mark.parametrize("rate_hz", [1.0, 10.0, 200.0])
@pytest.mark.parametrize("start_s", [0.0, 3.37])
def test_a_steady_topic_has_its_rate_in_every_bin_in_which_it_speaks(rate_hz: float, start_s: float) -> None:
    found = rates(every(1 / rate_hz, start_s, 60.0), 60 * S)
    assert len(found) == min(48, round((60 - start_s) * rate_hz) // 5)
    assert found[found > 0] == pytest.approx(rate_hz, rel=1e-6)
    assert (found > 0).sum() >= len(found) * (60 - start_s) / 60 - 1


def test_a_rate_that_halves_is_seen_to_halve() -> None:
    found = rates(np.concatenate([every(0.05, 0, 30), every(0.1, 30, 60)]), 60 * S)
    assert found[:23] == pytest.approx(20.0)
    assert found[25:] == pytest.approx(10.0)
