"""Overlays: a picture per camera, points where the scene has them, coloured by their range, whatever a name holds."""

import io
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from stone.geometry.se3 import SE3
from stone.sensors.calibration import CameraIntrinsics, Mount
from stone.sensors.sequence import Sequence
from stone_recordings.bags.bag import open_bag
from stone_recordings.report import overlay
from stone_recordings.report.overlay import drawn, overlays_of, range_colours
from stone_recordings.sync.camera_sweeps import CameraSweepPair
from tests.stone_recordings.calibrations.conftest import Drive

LENS = CameraIntrinsics("pinhole", 600, 400, 300, 300, 299.5, 199.5)
GREY = np.full((400, 600, 3), 128, np.uint8)


def overlays(drive: Drive, sequence: Sequence) -> dict[str, bytes]:
    with open_bag(drive.path) as bag:
        found = list(overlays_of(bag, sequence, drive.sweeps))
    assert {media_type for _, media_type, _ in found} <= {"image/jpeg"}
    assert len({name for name, _, _ in found}) == len(found)
    return {name: content for name, _, content in found}


def pixels_of(content: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(content))).astype(int)


def pair_of(points: list[tuple[float, float, float]]) -> CameraSweepPair:
    return CameraSweepPair(
        Mount("CAM", "camera", SE3.identity(), "", 0, LENS), "/cam", 0, np.array(points, float), SE3.identity()
    )


def test_each_camera_of_the_drive_has_its_picture_and_without_cameras_there_is_none(drive: Drive) -> None:
    found = overlays(drive, drive.sequence)
    assert set(found) == {f"overlay_{mount.name}.jpg" for mount in drive.sequence.calibration.of_kind("camera")}
    for content in found.values():
        assert pixels_of(content).shape == (150, 240, 3)
    bare = replace(drive.sequence, calibration=replace(drive.sequence.calibration, mounts=()))
    assert overlays(drive, bare) == {}


def test_a_point_is_painted_where_it_is_in_the_colour_of_its_range_the_near_one_first() -> None:
    found = pixels_of(drawn(GREY, pair_of([(0, 0, 5), (3, -1, 5)])))
    for x_px, y_px, range_m in ((300, 200, 5.0), (480, 140, 35**0.5)):
        expected = range_colours(np.array([range_m]))[0].astype(int)
        assert np.abs(found[y_px, x_px] - expected).max() < 60
    assert np.abs(found[100:110, 100:110] - 128).max() < 6, "elsewhere the picture stays"
    for points in ([(0, 0, 2), (0, 0, 40)], [(0, 0, 40), (0, 0, 2)]):
        red, _, blue = pixels_of(drawn(GREY, pair_of(points)))[200, 300]
        assert red > blue + 80
    near, far = range_colours(np.array([0.5, 500.0])).astype(int)
    assert near[0] > near[2] + 80
    assert far[2] > far[0] + 80
    assert (range_colours(np.array([0.5, 1.0]))[0] == range_colours(np.array([0.5, 1.0]))[1]).all()


def test_points_behind_or_none_leave_the_picture_and_a_hundred_thousand_most_of_it() -> None:
    assert pixels_of(drawn(GREY, replace(pair_of([]), points_lidar=np.zeros((0, 3))))).shape == (400, 600, 3)
    behind = pixels_of(drawn(GREY, pair_of([(0, 0, -5)])))
    assert np.abs(behind[190:210, 290:310] - 128).max() < 6
    places = np.random.default_rng(0).uniform((-5, -3, 5), (5, 3, 5), (100_000, 3))
    found = pixels_of(drawn(GREY, replace(pair_of([]), points_lidar=places)))
    assert 0.1 < (np.abs(found[:300] - 128).max(axis=2) > 40).mean() < 0.6


@pytest.mark.parametrize("name", ["../../etc/<script>", "カメラ" + "x" * 99])
def test_a_hostile_channel_names_a_plain_file(drive: Drive, name: str) -> None:
    sequence = drive.sequence
    mounts = tuple(replace(m, name=name) if m.name == "CAM_FRONT" else m for m in sequence.calibration.mounts)
    associations = {name if key == "CAM_FRONT" else key: value for key, value in sequence.frames.associations.items()}
    frames = replace(sequence.frames, associations=associations)
    found = overlays(drive, replace(sequence, calibration=replace(sequence.calibration, mounts=mounts), frames=frames))
    assert len(found) == 6
    for file in found:
        assert file.replace("_", "").replace("-", "").removesuffix(".jpg").isascii()
        assert not set(file) & set("/<>\\")
        assert len(file) < 90


def test_names_that_become_the_same_stay_apart(drive: Drive) -> None:
    sequence = drive.sequence
    renamed = {"CAM_FRONT": "a/b", "CAM_BACK": "a:b"}
    mounts = tuple(replace(m, name=renamed.get(m.name, m.name)) for m in sequence.calibration.mounts)
    associations = {renamed.get(key, key): value for key, value in sequence.frames.associations.items()}
    frames = replace(sequence.frames, associations=associations)
    changed = replace(sequence, calibration=replace(sequence.calibration, mounts=mounts), frames=frames)
    assert len(overlays(drive, changed)) == 6


def test_the_channels_name_can_be_read_in_a_third_of_the_size() -> None:
    """Pages show pictures of 1280 × 800 at 390 × 244: the capitals of the name are 8 px high there, not 4."""
    image = Image.new("RGB", (1280, 800))
    overlay._scale(image, "CAM_FRONT")
    rows = np.flatnonzero((np.asarray(image)[:200].min(axis=2) > 200).any(axis=1))
    assert np.ptp(rows) * 244 / 800 >= 8
