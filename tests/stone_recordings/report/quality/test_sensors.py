"""What is measured of pictures, clouds and positions, against slow loops and recordings of known quality."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter, laplace

from stone_recordings.report.quality.cameras import picture_facts, sharpness
from stone_recordings.report.quality.rtk import WORD_OF_TYPE
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


def test_zeros_in_a_cloud_are_no_returns(tmp_path: Path) -> None:
    path = written(tmp_path / "run.mcap", recordings.clouds(ticks(2, 10), valid=900, count=1200))
    (lidar,) = measured(path)[1].facts.lidars
    assert (lidar.topic, set(lidar.slots)) == (LIDAR, {1200})
    assert lidar.valid_ratio == pytest.approx([0.75] * len(lidar.at_ns))
    assert all(10 < range_m < 60 for range_m in lidar.range_m)


def test_only_the_detections_that_count_are_counted(tmp_path: Path) -> None:
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


def test_integer_ambiguities_are_fixed_and_float_ones_are_not() -> None:
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


def test_a_recording_without_messages_has_a_quality_too(tmp_path: Path) -> None:
    path = written(tmp_path / "run.mcap", [])
    _, quality = measured(path)
    assert (quality.facts.coverage, quality.facts.cameras, quality.facts.rtk) == ((), (), None)
    assert {deduction.code for deduction in quality.deductions} == {"TOP-101", "TOP-103"}


def test_one_message_is_no_period(tmp_path: Path) -> None:
    path = written(tmp_path / "run.mcap", [stamped("/imu", "sensor_msgs/msg/Imu", 10**18, "imu")])
    (topic,) = measured(path)[1].facts.coverage
    assert (topic.covered_ratio, topic.covered, topic.rates_hz) == (None, (), ())
