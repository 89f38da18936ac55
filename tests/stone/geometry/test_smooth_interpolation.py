"""Poses between poses: on the polynomial through their neighbours, kept out of gaps, jumps and ends."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import BarycentricInterpolator
from scipy.spatial.transform import Rotation

from stone.geometry.se3 import SE3
from stone.geometry.smooth_interpolation import with_between
from stone.geometry.trajectory import DEFAULT_MAX_GAP_NS, Trajectory

STEP_NS = 50_000_000


def track(stamps_ns: np.ndarray, angles_rad: np.ndarray, place_m: np.ndarray) -> Trajectory:
    wxyz = np.roll(Rotation.from_euler("ZYX", angles_rad).as_quat(), 1, axis=-1)
    return Trajectory(stamps_ns, SE3.from_parts(wxyz, place_m))


def wavy(stamps_ns: np.ndarray) -> Trajectory:
    """A robot on rough ground: 2 Hz of pitch and roll while it turns."""
    s = stamps_ns * 1e-9
    angles = np.stack([0.5 * s, 0.03 * np.sin(12 * s), 0.02 * np.cos(11 * s)], axis=-1)
    return track(stamps_ns, angles, np.stack([1.5 * s, 0.02 * np.sin(9 * s), 0.02 * np.cos(12 * s)], axis=-1))


def turned_deg(a: SE3, b: SE3) -> np.ndarray:
    between = (a.inverse() @ b).wxyz
    return np.rad2deg(2 * np.arctan2(np.linalg.norm(between[:, 1:], axis=1), np.abs(between[:, 0])))


@given(st.integers(0, 10_000))
@settings(max_examples=30, deadline=None)
def test_every_new_pose_is_on_the_polynomial_through_the_six_or_four_around_it(seed):
    generator = np.random.default_rng(seed)
    stamps_ns = np.cumsum(generator.integers(20_000_000, 90_000_000, 9))
    before = track(stamps_ns, generator.normal(0, 0.4, (9, 3)), generator.normal(0, 1, (9, 3)))
    after = with_between(before, DEFAULT_MAX_GAP_NS)
    assert len(after) == 9 + 7 * 6
    for stamp_ns, pose in zip(after.stamps_ns, after.map_from_ego.wxyz_xyz, strict=True):
        k = int(np.searchsorted(stamps_ns, stamp_ns, side="right")) - 1
        if stamp_ns in stamps_ns:
            np.testing.assert_array_equal(pose, before.map_from_ego.wxyz_xyz[k])
            continue
        reach = 1 if k in (1, 6) else 2
        near = np.arange(k - reach, k + reach + 2)
        around = before.map_from_ego[near]
        base = Rotation.from_quat(np.roll(around.wxyz[reach], -1))
        vectors = (base.inv() * Rotation.from_quat(np.roll(around.wxyz, -1, axis=-1))).as_rotvec()
        seconds = (stamps_ns[near] - stamps_ns[k]) * 1e-9
        at = float(stamp_ns - stamps_ns[k]) * 1e-9
        turn = base * Rotation.from_rotvec(BarycentricInterpolator(seconds, vectors)(at))
        assert (turn.inv() * Rotation.from_quat(np.roll(pose[:4], -1))).magnitude() < 1e-9
        place_m = BarycentricInterpolator(seconds, around.translation_m)(at)
        np.testing.assert_allclose(pose[4:], place_m, atol=1e-9)


def test_slerp_between_them_errs_by_less_than_a_tenth():
    coarse, fine_ns = wavy(np.arange(41, dtype=np.int64) * STEP_NS), np.arange(100_000_000, 1_900_000_000, 3_333_333)
    exact = wavy(fine_ns).map_from_ego
    plain, refined = (t.at(fine_ns).map_from_ego for t in (coarse, with_between(coarse, DEFAULT_MAX_GAP_NS)))
    plain_deg, refined_deg = turned_deg(exact, plain).max(), turned_deg(exact, refined).max()
    plain_m, refined_m = (np.abs(p.translation_m - exact.translation_m).max() for p in (plain, refined))
    assert plain_deg > 0.02
    assert refined_deg < plain_deg / 10
    assert refined_m < plain_m / 10


def test_gaps_jumps_and_ends_get_none():
    stamps_ns = np.arange(20, dtype=np.int64) * STEP_NS
    stamps_ns[10:] += 300_000_000
    parted = wavy(stamps_ns)
    segment = np.where(np.arange(20) >= 16, 1, 0)
    after = with_between(Trajectory(stamps_ns, parted.map_from_ego, segment), DEFAULT_MAX_GAP_NS)
    held = np.bincount(np.searchsorted(stamps_ns, after.stamps_ns, side="right") - 1, minlength=20) - 1
    assert held.tolist() == [0, *[7] * 7, 0, 0, 0, *[7] * 3, 0, 0, 0, 7, 0, 0]
    assert after.segment is not None
    expected = segment[np.searchsorted(stamps_ns, after.stamps_ns, side="right") - 1]
    assert after.segment.tolist() == expected.tolist()


@pytest.mark.parametrize("count", [1, 2, 3])
def test_too_few_poses_stay_as_they_are(count):
    few = wavy(np.arange(count, dtype=np.int64) * STEP_NS)
    assert with_between(few, DEFAULT_MAX_GAP_NS) is few


def test_samples_nanoseconds_apart_are_not_put_in_twice():
    near = wavy(np.arange(6, dtype=np.int64))
    after = with_between(near, DEFAULT_MAX_GAP_NS)
    np.testing.assert_array_equal(after.map_from_ego.wxyz_xyz, near.map_from_ego.wxyz_xyz)
