"""The playback: every picture small, every sweep thin, both where and when the frames have them."""

import io
import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from services.labeler.exports.playback import drawn, small_cloud, small_picture, write_playback
from stone.geometry.se3 import SE3
from stone.sensors.samples import CameraSample, LidarSample
from tests.services.labeler.exports.made import Labelled, files_of, unheard
from tests.services.labeler.exports.test_inputs import unlabelled
from tests.services.runtime.view_decoding import Read

IDENTITY = SE3(np.array([1.0, 0, 0, 0, 0, 0, 0]))


@pytest.fixture(scope="module")
def files(drive: Labelled, tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, bytes]:
    folder = tmp_path_factory.mktemp("playback")
    write_playback(drive.source(), folder, unheard)
    return files_of(folder)


def picture(width_px: int, height_px: int) -> CameraSample:
    file = io.BytesIO()
    gradient = np.linspace(0, 255, width_px * height_px * 3).astype(np.uint8).reshape(height_px, width_px, 3)
    Image.fromarray(gradient).save(file, "JPEG")
    return CameraSample(0, file.getvalue(), width_px, height_px)


def test_every_frame_has_its_sweep_and_the_picture_of_every_camera(drive: Labelled, files: Mapping[str, bytes]) -> None:
    tokens = drive.source().sequence.frames.tokens
    told = json.loads(files["playback.json"])
    assert told["has_clouds"]
    assert told["has_rays"]
    assert len(told["cameras"]) == 6
    names = {f"cameras/{channel}/{token}.jpg" for channel in told["cameras"] for token in tokens}
    assert set(files) == {"playback.json", "cameras.bin", *names, *(f"clouds/{token}.bin" for token in tokens)}
    sizes = {Image.open(io.BytesIO(files[name])).size for name in names}
    assert sizes == {(96, 60)}, "small ones are not blown up"


def test_points_stand_where_the_sweep_saw_them(drive: Labelled, files: Mapping[str, bytes]) -> None:
    source = drive.source()
    sweep, calibration = source.samples.lidar(3), source.sequence.calibration
    read = Read(files[f"clouds/{source.sequence.frames.tokens[3]}.bin"], b"STC1")
    (count,) = read.values("I", 1)
    found = np.array(read.values("h", 3 * count)).reshape(-1, 3) / 100
    assert count == len(sweep.points_lidar)
    np.testing.assert_allclose(found, calibration.ego_from_lidar @ sweep.points_lidar.astype(np.float64), atol=0.00501)


def test_a_playback_is_made_without_a_look_at_the_labels(
    drive: Labelled, files: Mapping[str, bytes], tmp_path: Path
) -> None:
    write_playback(unlabelled(drive.source()), tmp_path, unheard)
    assert files_of(tmp_path) == files


@pytest.mark.parametrize(("given", "made"), [((1920, 1200), (640, 400)), ((641, 480), (640, 479)), ((320, 240),) * 2])
def test_a_picture_is_at_most_640_pixels_wide(given: tuple[int, int], made: tuple[int, int]) -> None:
    content = small_picture(picture(*given))
    assert content is not None
    assert Image.open(io.BytesIO(content)).size == made


def test_a_picture_that_cannot_be_read_is_left_out() -> None:
    whole = picture(64, 48)
    for content in (b"", b"no picture", whole.content[:200]):
        assert small_picture(replace(whole, content=content)) is None
    assert small_picture(None) is None
    assert small_picture(CameraSample(0, whole.content, 10**5, 10**5)) is None


@pytest.mark.parametrize("total", [0, 1, 39_999, 40_000, 40_001, 80_000, 230_400])
def test_of_a_large_sweep_points_are_drawn_evenly(total: int) -> None:
    rows = drawn(total, 40_000)
    assert (np.diff(rows) > 0).all()
    assert min(total, 39_990) <= len(rows) <= 40_000
    for period in (2, 16, 128):  # rings that take turns
        counts = np.bincount(rows % period, minlength=period)
        assert total < 40_000 or counts.min() > 0.9 * len(rows) / period


def test_intensities_that_are_shares_are_stretched_and_those_that_are_bytes_are_not() -> None:
    points, rings = np.ones((3, 3), np.float32), np.zeros(3, np.uint16)
    for given, found in (([0, 0.5, 1.0], [0, 128, 255]), ([0, 100, 200], [0, 100, 200])):
        sweep = LidarSample(points, np.array(given, np.float32), rings)
        read = Read(small_cloud(sweep, IDENTITY), b"STC1")
        assert read.values("I", 1) == [3]
        assert read.values("h", 9) == [100] * 9
        assert read.values("B", 3) == found
