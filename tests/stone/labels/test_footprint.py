"""The swept footprint against a loop over all voxels and poses."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stone.geometry.lattice import centres_of, keys_from_indices
from stone.geometry.se3 import SE3
from stone.labels.footprint import BAND_M, STEP_M, STEP_RAD, _reached, densified, passed_through, swept
from stone.labels.voxels import VOXEL_M
from stone.sensors.calibration import Footprint

FOOTPRINT = Footprint()


def block(low, high):
    axes = [np.arange(a, b) for a, b in zip(low, high, strict=True)]
    return keys_from_indices(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3))


def path(*rows):
    """Poses of rows (x, y, z, yaw)."""
    return SE3(np.array([[math.cos(w / 2), 0, 0, math.sin(w / 2), x, y, z] for x, y, z, w in rows]))


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32))
def test_what_is_swept_is_what_lies_under_any_pose(seed):
    rng = np.random.default_rng(seed)
    tilt = rng.normal(size=(4, 3)) * [0.2, 0.2, 1.0]
    wxyz = np.concatenate([np.ones((4, 1)), tilt], axis=1)
    poses = SE3.from_parts(wxyz, rng.uniform(-1.0, 1.0, (4, 3)) * [1, 1, 0.2])
    keys = block((-12, -12, -6), (12, 12, 6))
    inside = np.zeros(len(keys), np.bool_)
    for pose in densified(poses, STEP_M, STEP_RAD).wxyz_xyz:
        x, y, z = np.abs(SE3(pose).inverse() @ centres_of(keys, VOXEL_M)).T
        inside |= (x <= FOOTPRINT.length_m / 2) & (y <= FOOTPRINT.width_m / 2) & (z <= BAND_M)
    assert (swept(keys, [poses], FOOTPRINT) == inside).all()


def test_a_straight_drive_over_a_plane_covers_exactly_its_rectangle():
    keys = block((-40, -10, 0), (40, 10, 1))
    x, y, _ = centres_of(keys, VOXEL_M).T
    expected = (x >= -2.04 - 0.53) & (x <= 3.04 + 0.53) & (np.abs(y) <= 0.425)
    under = swept(keys, [path((-2.04, 0, 0.1, 0), (3.04, 0, 0.1, 0))], FOOTPRINT)
    assert (under == expected).all()
    assert under.sum() == 31 * 4


def test_voxels_beyond_the_band_are_not_driven_on():
    keys = block((-2, -2, -5), (2, 2, 5))
    under = swept(keys, [path((0, 0, 0, 0))], FOOTPRINT, band_m=0.15)
    assert set(centres_of(keys[under], VOXEL_M)[:, 2].round(3)) == {-0.1, 0.1}


def test_every_surface_voxel_under_a_curved_track_is_covered():
    angle = np.linspace(0, 2 * math.pi, 25)
    track = path(*[(6 * math.sin(a), 6 * (1 - math.cos(a)), 0.1, a) for a in angle])
    keys = block((-40, -10, 0), (40, 70, 1))
    x, y, _ = centres_of(keys, VOXEL_M).T
    off_track_m = np.abs(np.hypot(x, y - 6) - 6)
    under = swept(keys, [track], FOOTPRINT)
    sagitta_m = 6 * (1 - math.cos(math.pi / 24))  # poses between are interpolated on the chord
    assert under[off_track_m <= FOOTPRINT.width_m / 2 - sagitta_m].all()
    assert not under[off_track_m > math.hypot(6 + 0.425, 0.53) - 6 + sagitta_m].any()


def test_the_way_between_two_poses_is_covered():
    keys = block((-5, -2, 0), (60, 2, 1))
    x, _, _ = centres_of(keys, VOXEL_M).T
    under = swept(keys, [path((0, 0, 0.1, 0), (10, 0, 0.1, 0))], FOOTPRINT)
    assert under[(x >= -0.53) & (x <= 10.53)].all()


def test_nothing_is_driven_between_two_stretches():
    keys = block((-5, -2, 0), (60, 2, 1))
    x, _, _ = centres_of(keys, VOXEL_M).T
    under = swept(keys, [path((0, 0, 0.1, 0), (1, 0, 0.1, 0)), path((8, 0, 0.1, 0), (10, 0, 0.1, 0))], FOOTPRINT)
    assert under[(x <= 1.53) | ((x >= 7.47) & (x <= 10.53))].sum() == under.sum()
    assert not under[(x > 1.53) & (x < 7.47)].any()


def test_a_robot_that_turns_on_the_spot_sweeps_a_disc_with_its_corners():
    keys = block((-6, -6, 0), (6, 6, 1))
    x, y, _ = centres_of(keys, VOXEL_M).T
    quarter_turns = path(*[(0, 0, 0.1, math.radians(angle)) for angle in (0, 90, 180)])
    reach_m = math.hypot(FOOTPRINT.length_m, FOOTPRINT.width_m) / 2
    assert swept(keys, [quarter_turns], FOOTPRINT)[np.hypot(x, y) <= reach_m - 0.01].all()


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32), st.integers(2, 8), st.floats(0.05, 2))
def test_densified_poses_keep_the_given_ones_and_are_close_together(seed, count, step_m):
    rng = np.random.default_rng(seed)
    poses = SE3.from_parts(rng.normal(size=(count, 4)), rng.uniform(-2, 2, (count, 3)))
    dense = densified(poses, step_m)
    gaps = np.linalg.norm(np.diff(dense.translation_m, axis=0), axis=1)
    assert gaps.max() <= step_m + 1e-9
    for pose in poses.translation_m:
        assert np.linalg.norm(dense.translation_m - pose, axis=1).min() < 1e-12


@pytest.mark.parametrize("count", [0, 1])
def test_fewer_than_two_poses_have_nothing_between(count):
    poses = SE3.identity((count,))
    assert len(densified(poses, 0.1)) == count
    keys = block((-3, -3, 0), (3, 3, 1))
    assert swept(keys, [poses], FOOTPRINT).any() == (count == 1)


def test_no_voxels_are_swept_where_there_are_none():
    assert swept(np.zeros(0, np.int64), [path((0, 0, 0, 0))], FOOTPRINT).shape == (0,)


def test_the_body_goes_through_what_is_above_its_clearance_and_below_its_top():
    keys = block((-12, -8, -2), (12, 8, 20))
    x, y, z = centres_of(keys, 0.1).T
    passed = passed_through(keys, 0.1, [path((0, 0, 0, 0), (0.6, 0, 0, 0))], FOOTPRINT, (0.3, 1.2))
    expected = (x >= -0.53) & (x <= 1.13) & (np.abs(y) <= 0.425) & (z >= 0.3) & (z <= 1.2)
    assert (passed == expected).all()
    assert not passed_through(keys, 0.1, [path((0, 0, 0, 0))], FOOTPRINT, (0.3, 0.2)).any()


@pytest.mark.parametrize("voxel_m", [0.1, VOXEL_M])
def test_what_is_looked_at_is_as_flat_as_the_footprint(voxel_m):
    """A cube around 50 m of it was 343 million voxels a pose."""
    pose = path((3.0, -2.0, 0.4, 0.3)).as_matrix()[0]
    spans = [_reached.py_func(pose[axis], (25.0, 25.0, -0.15, 0.15, voxel_m)) for axis in range(3)]
    x, y, z = (end - first for first, end in spans)
    assert max(x, y) <= 50 * (math.cos(0.3) + math.sin(0.3)) / voxel_m + 4
    assert z <= 0.3 / voxel_m + 4
