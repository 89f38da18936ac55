"""The cameras of a playback: where each was when it took its picture, and what its lens sees."""

from dataclasses import replace

import numpy as np
import pytest

from services.labeler.exports.nuscenes.plan import channels_of
from services.labeler.exports.playback_cameras import COLUMNS, ROWS, playback_cameras, shutter_poses
from stone.geometry.se3 import SE3
from stone.sensors.projection import project
from stone.sensors.sequence import Sequence
from tests.services.labeler.exports.made import Labelled


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
