"""The previews show what the recording holds, are the same every time, and leave out what lies."""

import math
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from PIL import Image

from stone.geometry.se3 import SE3
from stone_recordings.bags.bag import open_bag
from stone_recordings.report.inspection import inspect
from stone_recordings.report.previews.camera_strip import COLUMNS, GAP_PX, TILE, TILE_WIDTH_PX
from stone_recordings.report.previews.pictures import previews_of
from stone_recordings.report.previews.sweep_view import RASTER_PX, from_above
from stone_recordings.report.previews.track_view import RecordedTrack, track_of, track_view
from stone_recordings.report.quality.report import quality_of
from stone_recordings.report.quality.sampling import SampledMessages
from tests.stone_recordings.report.quality import recordings
from tests.stone_recordings.report.quality.recordings import ticks
from tests.stone_recordings.rigs import SPEED_M_S, YAW_RATE_RAD_S, odometry, transform, world_from_ego, written

RING = ("front_left", "front", "front_right", "back_left", "back", "back_right")
LEVELS = (30, 70, 110, 150, 190, 230)


def previews(path: Path) -> dict[str, tuple[str, bytes]]:
    inspection = inspect(path)
    with open_bag(path) as bag:
        return {name: (media_type, content) for name, media_type, content in previews_of(bag, inspection)}


def pixels(content: bytes) -> NDArray[np.uint8]:
    return np.asarray(Image.open(BytesIO(content)).convert("RGB"))


def track(path: Path) -> RecordedTrack | None:
    inspection = inspect(path)
    with open_bag(path) as bag:
        return track_of(bag, inspection)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six cameras of known brightness, a LiDAR and an INS."""
    stamps = ticks(2, 5)
    cameras = [
        recordings.pictures(f"/camera/{place}/image", stamps, level, 2)
        for place, level in zip(RING, LEVELS, strict=True)
    ]
    path = tmp_path_factory.mktemp("whole") / "run.mcap"
    return written(path, *cameras, recordings.clouds(stamps), recordings.solutions(ticks(2, 20), 56))


@pytest.mark.whole
def test_a_whole_rig_has_three_pictures_that_open_and_are_the_same_every_time(whole: Path) -> None:
    first = previews(whole)
    assert {name: media_type for name, (media_type, _) in first.items()} == {
        "cameras.jpg": "image/jpeg", "sweep.png": "image/png", "track.png": "image/png",
    }  # fmt: skip
    for media_type, content in first.values():
        assert f"image/{(Image.open(BytesIO(content)).format or '').lower()}" == media_type
        assert len(content) < 2**20
    assert previews(whole) == first


@pytest.mark.whole
def test_previews_are_the_same_where_messages_were_sampled_before(whole: Path) -> None:
    inspection = inspect(whole)
    with open_bag(whole) as bag:
        sampled = SampledMessages(bag)
        quality_of(bag, inspection, sampled)
        after = {name: (media_type, content) for name, media_type, content in previews_of(bag, inspection, sampled)}
    assert after == previews(whole)


def test_the_strip_holds_every_camera_at_its_place_in_the_ring(whole: Path) -> None:
    strip = pixels(previews(whole)["cameras.jpg"][1])
    height_px = round(TILE_WIDTH_PX * 60 / 96)
    assert strip.shape == (2 * height_px + GAP_PX, COLUMNS * (TILE_WIDTH_PX + GAP_PX) - GAP_PX, 3)
    for place, level in enumerate(LEVELS):
        row, column = divmod(place, COLUMNS)
        top, left = row * (height_px + GAP_PX), column * (TILE_WIDTH_PX + GAP_PX)
        assert strip[top + 60 : top + 200, left + 60 : left + 400].mean() == pytest.approx(level, abs=3)


def test_a_camera_that_lies_has_a_tile_without_a_picture(tmp_path: Path) -> None:
    stamps = ticks(1, 5)
    lies = [recordings.picture("/camera/front/image", int(stamp), b"\x89PNG\r\n\x1a\nno") for stamp in stamps]
    path = written(tmp_path / "run.mcap", lies, recordings.pictures("/camera/back/image", stamps, 200, 2))
    strip = pixels(previews(path)["cameras.jpg"][1])
    assert strip.shape[1] == 2 * TILE_WIDTH_PX + GAP_PX
    assert np.abs(strip[20:60, 20:400].astype(int) - TILE).max() < 12
    assert strip[60:200, TILE_WIDTH_PX + 60 : -60].mean() == pytest.approx(200, abs=3)


def test_pictures_of_another_shape_are_fitted_in(tmp_path: Path) -> None:
    stamps = ticks(1, 5)
    tall = [
        recordings.picture("/camera/back/image", int(stamp), recordings.photo(200, 2, 0, (20, 200))) for stamp in stamps
    ]
    path = written(tmp_path / "run.mcap", tall, recordings.pictures("/camera/front/image", stamps, 60, 2))
    back = pixels(previews(path)["cameras.jpg"][1])[:, TILE_WIDTH_PX + GAP_PX :]
    assert back[100, 235:245].mean() == pytest.approx(200, abs=4)
    assert np.abs(back[100, :100].astype(int) - TILE).max() < 12


@pytest.mark.parametrize("messages", [[], recordings.clouds(ticks(1, 5), valid=0)], ids=["nothing", "empty sweeps"])
def test_a_recording_with_nothing_to_show_has_no_previews(tmp_path: Path, messages: list[recordings.Recorded]) -> None:
    assert previews(written(tmp_path / "run.mcap", messages)) == {}


@given(count=st.integers(0, 300), radius_m=st.sampled_from([5.0, 20.0]), seed=st.integers(0, 2**31))
def test_seen_from_above_every_pixel_has_the_highest_point_in_it(count: int, radius_m: float, seed: int) -> None:
    points = np.random.default_rng(seed).uniform(-1.2 * radius_m, 1.2 * radius_m, (count, 3)).astype(np.float32)
    highest: dict[tuple[int, int], float] = {}
    for x, y, z in points.tolist():
        cell = tuple(math.floor((value + radius_m) * (RASTER_PX / (2 * radius_m))) for value in (y, x))
        if all(0 <= place < RASTER_PX for place in cell):
            highest[cell] = max(z, highest.get(cell, -math.inf))  # type: ignore[index, call-overload]
    raster = from_above(points, radius_m)
    assert all(raster[cell] == np.float32(z) for cell, z in highest.items())
    drawn = np.isfinite(raster).sum()
    assert len(highest) <= drawn <= 4 * len(highest)  # every point is two pixels wide


def test_the_track_of_an_ins_is_the_circle_that_was_driven(tmp_path: Path) -> None:
    found = track(written(tmp_path / "run.mcap", recordings.solutions(ticks(10, 20), 56)))
    assert found is not None
    assert (found.source, found.is_geodetic, set(found.words)) == ("INSPVAX", True, {"fixed"})
    length_m = np.linalg.norm(np.diff(found.points_m, axis=0), axis=1).sum()
    assert length_m == pytest.approx(SPEED_M_S * 9.95, rel=0.2)  # the antenna swings beside the robot
    assert found.points_m[0].tolist() == [0.0, 0.0]


@pytest.mark.parametrize("kind", ["odometry", "tf"])
def test_odometry_and_tf_tell_the_track_in_their_own_frame(tmp_path: Path, kind: str) -> None:
    stamps = ticks(4, 20)
    truth = world_from_ego(stamps)
    wheel = SE3.identity()
    messages = [
        odometry(int(stamp), pose) if kind == "odometry" else transform("/tf", int(stamp), "odom", "base_link", pose)
        for stamp, pose in zip(stamps, (truth[row] for row in range(len(stamps))), strict=True)
    ]
    wheels = [transform("/tf", int(stamp) + 1, "base_link", "wheel", wheel) for stamp in stamps]
    found = track(written(tmp_path / "run.mcap", messages, wheels if kind == "tf" else []))
    assert found is not None
    assert (found.words, found.is_geodetic) == ((), False)
    np.testing.assert_allclose(found.points_m, truth.translation_m[:, :2], atol=1e-9)


def test_a_position_beyond_the_horizon_is_left_out(tmp_path: Path) -> None:
    stamps = ticks(3, 20)
    poses = [world_from_ego(stamps)[row] for row in range(len(stamps))]
    far = SE3.from_parts(np.array([1.0, 0, 0, 0]), np.array([1e7, 0.0, 0.0]))
    lost = SE3.from_parts(np.array([1.0, 0, 0, 0]), np.array([0.0, 1e300, 0.0]))
    messages = [odometry(int(stamp), pose) for stamp, pose in zip(stamps, [far, lost, *poses[2:]], strict=True)]
    found = track(written(tmp_path / "run.mcap", messages))
    assert found is not None
    assert len(found.points_m) == len(stamps) - 2
    assert np.abs(found.points_m).max() < 2 * SPEED_M_S / YAW_RATE_RAD_S


def test_one_position_is_no_track_and_a_robot_that_stands_still_is_drawn(tmp_path: Path) -> None:
    still = RecordedTrack("Odometry", np.zeros((5, 2)), (), False)
    assert pixels(track_view(still)).shape == (896, 896, 3)
    assert track(written(tmp_path / "run.mcap", recordings.solutions(ticks(0.05, 20), 56))) is None
