"""Jumps are found where no vehicle moves so, wherever in the track, and nothing else is one."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stone.geometry.jumps import MotionLimits, jumps_of, split
from stone.geometry.se3 import SE3
from stone.geometry.trajectory import PoseStatus, Trajectory

STEP_NS = 50_000_000


def driven(count: int = 60, speed_m_s: float = 5.0, noise_m: float = 0.0, seed: int = 0) -> Trajectory:
    """Along a circle of 150 m, with noise of its own at every pose."""
    stamps_ns = np.arange(count, dtype=np.int64) * STEP_NS
    angle = speed_m_s / 150 * stamps_ns * 1e-9
    place = 150 * np.stack([np.sin(angle), 1 - np.cos(angle), 0.01 * np.sin(3 * angle)], axis=-1)
    wxyz = np.stack([np.cos(angle / 2), 0 * angle, 0 * angle, np.sin(angle / 2)], axis=-1)
    noise = noise_m * np.random.default_rng(seed).standard_normal(place.shape)
    return Trajectory(stamps_ns, SE3.from_parts(wxyz, place + noise))


def moved(trajectory: Trajectory, begin: int, end: int, by_m: np.ndarray) -> Trajectory:
    poses = trajectory.map_from_ego.wxyz_xyz.copy()
    poses[begin:end, 4:] += by_m
    return Trajectory(trajectory.stamps_ns, SE3(poses))


@given(st.integers(1, 59), st.floats(0.25, 500), st.floats(0, 2 * np.pi), st.floats(0, 30))
@settings(max_examples=60, deadline=None)
def test_a_step_of_a_quarter_metre_is_found_wherever_it_is_and_however_fast_the_robot(at, size_m, towards, speed_m_s):
    by_m = size_m * np.array([np.cos(towards), np.sin(towards), 0.0])
    found = jumps_of(moved(driven(speed_m_s=speed_m_s), at, 60, by_m))
    assert found.steps.tolist() == [at - 1]
    assert found.excess_m[0] == pytest.approx(size_m, abs=0.03)


@given(st.integers(0, 1000), st.floats(0, 30))
@settings(max_examples=40, deadline=None)
def test_a_drive_with_centimetres_of_noise_has_no_jump(seed, speed_m_s):
    assert len(jumps_of(driven(speed_m_s=speed_m_s, noise_m=0.01, seed=seed)).steps) == 0


def test_braking_and_turning_as_hard_as_a_vehicle_can_is_no_jump():
    stamps_ns = np.arange(80, dtype=np.int64) * STEP_NS
    speed = np.clip(12.0 - 7.5 * (stamps_ns * 1e-9 - 1.0).clip(0), 0, None)
    x = np.cumsum(speed) * STEP_NS * 1e-9
    place = np.stack([x, 0 * x, 0 * x], axis=-1)
    turn = np.minimum(stamps_ns * 1e-9, 3.0)
    wxyz = np.stack([np.cos(turn), 0 * turn, 0 * turn, np.sin(turn)], axis=-1)
    assert len(jumps_of(Trajectory(stamps_ns, SE3.from_parts(wxyz, place))).steps) == 0


def test_an_outlier_is_two_jumps_and_stands_alone():
    track = moved(driven(), 20, 21, np.array([0.0, 0.0, 3.0]))
    found = jumps_of(track)
    assert found.steps.tolist() == [19, 20]
    parted = split(track, found.steps)
    assert np.unique(parted.segment, return_counts=True)[1].tolist() == [20, 1, 39]


def test_a_smaller_step_is_suspicious_where_the_status_changes():
    track = moved(driven(), 30, 60, np.array([0.09, 0.0, 0.0]))
    has_changed = np.zeros(59, np.bool_)
    assert len(jumps_of(track, has_changed).steps) == 0
    has_changed[29] = True
    assert jumps_of(track, has_changed).steps.tolist() == [29]
    has_changed[:] = True
    assert jumps_of(track, has_changed).steps.tolist() == [29]


def test_a_leap_of_the_heading_is_a_jump():
    poses = driven().map_from_ego.wxyz_xyz.copy()
    poses[40:, :4] = SE3.from_parts(np.array([np.cos(0.5), 0, 0, np.sin(0.5)]), np.zeros(3)).wxyz
    assert jumps_of(Trajectory(driven().stamps_ns, SE3(poses))).steps.tolist() == [39]


@pytest.mark.parametrize(("count", "expected"), [(1, []), (2, [0]), (3, [0])])
def test_few_poses_are_judged_by_their_speed_alone(count, expected):
    track = driven(count)
    assert len(jumps_of(track).steps) == 0
    if count > 1:
        assert jumps_of(moved(track, 1, count, np.array([2.0, 0, 0]))).steps.tolist() == expected


def test_a_silence_allows_what_the_acceleration_could_have_done_meanwhile():
    track = driven()
    later = track.stamps_ns + np.where(np.arange(60) >= 30, 950_000_000, 0)
    paused = Trajectory(later, moved(track, 30, 60, np.array([5.0 * 0.95, 4.0, 0.0])).map_from_ego)
    assert len(jumps_of(paused).steps) == 0
    assert jumps_of(paused, limits=MotionLimits(acceleration_m_s2=1.0)).steps.tolist() == [29]


def test_nothing_is_interpolated_across_a_split_and_everything_else_is_as_before():
    track = driven()
    parted = split(track, np.array([29]))
    assert split(track, np.array([], np.int64)) is track
    queries = np.arange(0, 59 * STEP_NS, STEP_NS // 5, dtype=np.int64)
    whole, found = track.at(queries), parted.at(queries)
    is_across = (queries > 29 * STEP_NS) & (queries < 30 * STEP_NS)
    assert is_across.sum() == 4
    assert (found.status[is_across] == PoseStatus.SPLIT).all()
    assert np.isnan(found.map_from_ego.wxyz_xyz[is_across]).all()
    np.testing.assert_array_equal(found.map_from_ego.wxyz_xyz[~is_across], whole.map_from_ego.wxyz_xyz[~is_across])
    assert found.is_ok.sum() == len(queries) - 4
    assert np.unique(found.segment).tolist() == [0, 1]
