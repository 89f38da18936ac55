"""The playback: every picture small, every sweep thin, both where and when the frames have them; and its cameras: where
each was when it took its picture, and what its lens sees."""

import io
import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from services.labeler.exports.nuscenes.plan import channels_of
from services.labeler.exports.playback import (
    COLUMNS,
    ROWS,
    drawn,
    playback_cameras,
    shutter_poses,
    small_cloud,
    small_picture,
    write_playback,
)
from stone.geometry.se3 import SE3
from stone.sensors.projection import project
from stone.sensors.samples import CameraSample, LidarSample
from stone.sensors.sequence import Sequence
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
    sweeps = {f"{kind}/{token}.bin" for kind in ("clouds", "radars") for token in tokens}
    assert set(files) == {"playback.json", "cameras.bin", *names, *sweeps}
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


def test_radars_detect_what_the_samples_of_all_of_them_hold(drive: Labelled, files: Mapping[str, bytes]) -> None:
    """Moved to the frame's stamp, in the ego frame, with their speeds over ground."""
    source = drive.source()
    assert json.loads(files["playback.json"])["has_radars"]
    radars = [mount.name for mount in source.sequence.calibration.of_kind("radar")]
    scans = [scan for radar in radars if (scan := source.samples.radar(radar, 3)) is not None]
    assert len(scans) > 1
    points = np.concatenate([scan.points_lidar for scan in scans])
    rates = np.concatenate([scan.ground_rate_m_s for scan in scans])
    is_known = np.isfinite(points).all(axis=1) & np.isfinite(rates)
    read = Read(files[f"radars/{source.sequence.frames.tokens[3]}.bin"], b"STE1")
    assert read.values("I", 1) == [is_known.sum()]
    found = np.array(read.values("h", 3 * is_known.sum())).reshape(-1, 3) / 100
    np.testing.assert_allclose(found, source.sequence.calibration.ego_from_lidar @ points[is_known], atol=0.00501)
    np.testing.assert_allclose(np.array(read.values("h", is_known.sum())) / 100, rates[is_known], atol=0.00501)
    assert read.is_over()


def test_every_sensor_stands_where_the_calibration_says(drive: Labelled, files: Mapping[str, bytes]) -> None:
    """By homogeneous matrices, of the channels of the nuScenes export and whatever else is mounted."""
    calibration = drive.source().sequence.calibration
    told = {one["channel"]: one for one in json.loads(files["playback.json"])["sensors"]}
    assert set(told) == {"LIDAR_TOP", *(mount.name for mount in calibration.mounts)}
    assert {one["kind"] for one in told.values()} >= {"lidar", "camera", "radar"}
    ego_from_lidar = calibration.ego_from_lidar.as_matrix()
    wanted = {mount.name: ego_from_lidar @ mount.lidar_from_sensor.as_matrix() for mount in calibration.mounts}
    wanted["LIDAR_TOP"] = ego_from_lidar
    for channel, matrix in wanted.items():
        pose = np.array(told[channel]["ego_from_sensor"])
        found = SE3(np.concatenate([pose[3:], pose[:3]]))
        np.testing.assert_allclose(found.as_matrix(), matrix, atol=1e-9)


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


@pytest.fixture(scope="module")
def sequence(drive: Labelled) -> Sequence:
    return drive.source().sequence


def test_a_camera_stands_where_the_nuscenes_export_says_it_was_at_its_shutter(sequence: Sequence) -> None:
    """Catches alone a camera that is placed by the frame's pose: a turning robot is degrees off by then."""
    cameras = [channel for channel in channels_of(sequence) if channel.modality == "camera"]
    assert len(cameras) == 6
    for channel in cameras:
        frames = channel.frames
        poses = shutter_poses(sequence, channel.name)
        found = SE3(np.concatenate([poses[frames, 3:], poses[frames, :3]], axis=1))
        mounted = sequence.calibration.ego_from_lidar @ channel.mount.lidar_from_sensor
        map_from_camera = channel.map_from_ego @ mounted
        ours = sequence.frames.map_from_ego[frames] @ found
        np.testing.assert_allclose(ours.as_matrix(), map_from_camera.as_matrix(), atol=1e-9)
        still = sequence.frames.map_from_ego[frames] @ mounted
        moved = np.abs(still.as_matrix() - map_from_camera.as_matrix()).max()
        assert channel.stamps_ns.tolist() != sequence.frames.stamps_ns[frames].tolist()
        assert moved > 1e-3, "the drive moves between a sweep and its pictures"
        others = np.setdiff1d(np.arange(len(sequence.frames)), frames)
        assert np.isnan(poses[others]).all()


def test_the_rays_of_every_camera_are_seen_at_the_nodes_of_its_grid(sequence: Sequence) -> None:
    names = [mount.name for mount in sequence.calibration.of_kind("camera")]
    cameras = playback_cameras(sequence, names, np.ones((len(names), len(sequence.frames)), np.bool_))
    assert cameras.rays.shape == (len(names), ROWS, COLUMNS, 3)
    for place, name in enumerate(names):
        mount = sequence.calibration.mount(name)
        assert mount is not None
        assert mount.intrinsics is not None
        lens = mount.intrinsics
        pixels, _ = project(cameras.rays[place].reshape(-1, 3), lens)
        grid = pixels.reshape(ROWS, COLUMNS, 2)
        np.testing.assert_allclose(grid[0, 0], (-0.5, -0.5), atol=1e-3)
        np.testing.assert_allclose(grid[-1, -1], (lens.width_px - 0.5, lens.height_px - 0.5), atol=1e-3)
        np.testing.assert_allclose(np.diff(grid[:, :, 0], axis=1), lens.width_px / (COLUMNS - 1), atol=1e-3)


def test_a_camera_without_intrinsics_has_no_rays_and_no_poses(sequence: Sequence) -> None:
    blind = tuple(replace(mount, intrinsics=None) for mount in sequence.calibration.mounts)
    stripped = replace(sequence, calibration=replace(sequence.calibration, mounts=blind))
    name = sequence.calibration.of_kind("camera")[0].name
    cameras = playback_cameras(stripped, [name, "CAM_NOWHERE"], np.ones((2, len(sequence.frames)), np.bool_))
    assert np.isnan(cameras.rays).all()
    assert np.isnan(cameras.ego_from_camera).all()
