"""Poses between poses, against scipy; jumps, gaps and stretches of a track; a reason instead of a pose elsewhere."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import BarycentricInterpolator
from scipy.spatial.transform import Rotation, Slerp

from stone.errors import ShapeError
from stone.geometry.jumps import MotionLimits, jumps_of, split
from stone.geometry.se3 import SE3
from stone.geometry.segments import segments_at, split_at_gaps
from stone.geometry.smooth_interpolation import with_between
from stone.geometry.trajectory import DEFAULT_MAX_GAP_NS, PoseStatus, Trajectory
from testing.refusals import refused_as

T0_NS = 1_760_000_000_000_000_000
STEP_NS = 50_000_000


def wandering(count: int, seed: int = 0) -> tuple[Trajectory, Rotation, np.ndarray]:
    rng = np.random.default_rng(seed)
    turn = Rotation.from_euler("zyx", np.cumsum(rng.normal(0, 0.2, (count, 3)), axis=0))
    position_m = np.cumsum(rng.normal(0, 0.3, (count, 3)), axis=0)
    wxyz = np.roll(turn.as_quat(), 1, axis=-1) * rng.choice([-1.0, 1.0], (count, 1))
    stamps_ns = T0_NS + np.arange(count) * STEP_NS + np.sort(rng.integers(0, STEP_NS // 3, count))
    return Trajectory(stamps_ns, SE3.from_parts(wxyz, position_m)), turn, position_m


@settings(max_examples=40, deadline=None)
@given(st.integers(2, 30), st.integers(0, 2**32))
def test_between_poses_it_is_scipys_slerp_and_a_straight_line(count, seed):
    trajectory, turn, position_m = wandering(count, seed)
    seconds = (trajectory.stamps_ns - T0_NS) * 1e-9
    query_ns = np.random.default_rng(seed).integers(trajectory.stamps_ns[0], trajectory.stamps_ns[-1], 50)
    found = trajectory.at(query_ns)
    assert found.is_ok.all()
    at_s = np.clip((query_ns - T0_NS) * 1e-9, seconds[0], seconds[-1])
    oracle = Slerp(seconds, turn)(at_s)
    np.testing.assert_allclose(found.map_from_ego.rotation(), oracle.as_matrix(), atol=1e-6)
    line = np.stack([np.interp(at_s, seconds, position_m[:, axis]) for axis in range(3)], axis=1)
    np.testing.assert_allclose(found.map_from_ego.translation_m, line, atol=1e-6)


def test_on_a_stamp_it_is_that_pose_bit_for_bit_in_position():
    trajectory, _, position_m = wandering(20)
    found = trajectory.at(trajectory.stamps_ns)
    assert found.is_ok.all()
    assert not found.gap_ns.any()
    np.testing.assert_array_equal(found.map_from_ego.translation_m, position_m)
    np.testing.assert_allclose(found.map_from_ego.wxyz, trajectory.map_from_ego.wxyz, atol=1e-15)


def test_one_nanosecond_outside_is_never_extrapolated():
    trajectory, _, _ = wandering(5)
    first, last = trajectory.stamps_ns[[0, -1]]
    found = trajectory.at(np.array([first - 1, first, last, last + 1]))
    assert found.status.tolist() == [PoseStatus.BEFORE_FIRST, PoseStatus.OK, PoseStatus.OK, PoseStatus.AFTER_LAST]
    assert np.isnan(found.map_from_ego.wxyz_xyz[[0, 3]]).all()
    assert found.gap_ns.tolist() == [0, 0, 0, 0]


def test_a_gap_is_bridged_up_to_its_limit_and_not_beyond():
    stamps_ns = T0_NS + np.array([0, 250_000_000, 500_000_001])
    trajectory = Trajectory(stamps_ns, SE3.identity((3,)))
    found = trajectory.at(stamps_ns[[0, 1]] + 100)
    assert found.status.tolist() == [PoseStatus.OK, PoseStatus.GAP]
    assert found.gap_ns.tolist() == [250_000_000, 250_000_001]
    assert np.isnan(found.map_from_ego.wxyz_xyz[1]).all()
    assert trajectory.at(stamps_ns).is_ok.all()


def test_a_single_pose_answers_for_its_stamp_only():
    found = Trajectory(np.array([T0_NS]), SE3.identity((1,))).at(T0_NS + np.array([-1, 0, 1]))
    assert found.status.tolist() == [PoseStatus.BEFORE_FIRST, PoseStatus.OK, PoseStatus.AFTER_LAST]


def test_what_is_no_trajectory_is_refused():
    with refused_as("trajectory_stamps"):
        Trajectory(T0_NS + np.array([0, 1, 1]), SE3.identity((3,)))
    with refused_as("empty_trajectory"):
        Trajectory(np.array([], np.int64), SE3.identity((0,)))
    with pytest.raises(ShapeError):
        Trajectory(T0_NS + np.array([0, 1]), SE3.identity((3,)))


def driven(count: int = 60, speed_m_s: float = 5.0, noise_m: float = 0.0, seed: int = 0) -> Trajectory:
    """Along a circle of 150 m, with noise of its own at every pose."""
    stamps_ns = np.arange(count, dtype=np.int64) * STEP_NS
    angle = speed_m_s / 150 * stamps_ns * 1e-9
    place = 150 * np.stack([np.sin(angle), 1 - np.cos(angle), 0.01 * np.sin(3 * angle)], axis=-1)
    wxyz = np.stack([np.cos(angle / 2), 0 * angle, 0 * angle, np.sin(angle / 2)], axis=-1)
    noise = noise_m * np.random.default_rng(seed).standard_normal(place.shape)
    return Trajectory(stamps_ns, SE3.from_parts(wxyz, place + noise))


def shifted(trajectory: Trajectory, begin: int, end: int, by_m: np.ndarray) -> Trajectory:
    poses = trajectory.map_from_ego.wxyz_xyz.copy()
    poses[begin:end, 4:] += by_m
    return Trajectory(trajectory.stamps_ns, SE3(poses))


@given(st.integers(1, 59), st.floats(0.25, 500), st.floats(0, 2 * np.pi), st.floats(0, 30))
@settings(max_examples=60, deadline=None)
def test_a_step_of_a_quarter_metre_is_found_wherever_it_is_and_however_fast_the_robot(at, size_m, towards, speed_m_s):
    by_m = size_m * np.array([np.cos(towards), np.sin(towards), 0.0])
    found = jumps_of(shifted(driven(speed_m_s=speed_m_s), at, 60, by_m))
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
    track = shifted(driven(), 20, 21, np.array([0.0, 0.0, 3.0]))
    found = jumps_of(track)
    assert found.steps.tolist() == [19, 20]
    parted = split(track, found.steps)
    assert np.unique(parted.segment, return_counts=True)[1].tolist() == [20, 1, 39]


def test_a_smaller_step_is_suspicious_where_the_status_changes():
    track = shifted(driven(), 30, 60, np.array([0.09, 0.0, 0.0]))
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
        assert jumps_of(shifted(track, 1, count, np.array([2.0, 0, 0]))).steps.tolist() == expected


def test_a_silence_allows_what_the_acceleration_could_have_done_meanwhile():
    track = driven()
    later = track.stamps_ns + np.where(np.arange(60) >= 30, 950_000_000, 0)
    paused = Trajectory(later, shifted(track, 30, 60, np.array([5.0 * 0.95, 4.0, 0.0])).map_from_ego)
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


STAMPS_NS = np.array([0, 100, 200, 900, 1000, 1100], np.int64)
TRACK = Trajectory(STAMPS_NS, SE3.identity((6,)))


def test_a_gap_longer_than_the_limit_begins_a_segment_and_one_as_long_does_not():
    assert split_at_gaps(TRACK, 699).segments.tolist() == [0, 0, 0, 1, 1, 1]
    assert split_at_gaps(TRACK, 700) is TRACK


def test_gaps_and_jumps_are_numbered_together_in_time():
    jumped = split(TRACK, np.array([0, 4]))
    assert split_at_gaps(jumped, 300).segments.tolist() == [0, 1, 1, 2, 2, 3]


def test_a_time_belongs_to_the_stretch_of_the_last_pose_before_it_and_the_first_to_times_before_all():
    track = split_at_gaps(TRACK, 300)
    assert segments_at(track, np.array([-50, 0, 200, 899, 900, 5000])).tolist() == [0, 0, 0, 0, 1, 1]


def test_a_gap_is_still_called_a_gap_where_it_is_asked_for_a_pose():
    asked = np.array([500], np.int64)
    assert split_at_gaps(TRACK, 300).at(asked, 300).status.tolist() == [PoseStatus.GAP]


def track_through(stamps_ns: np.ndarray, angles_rad: np.ndarray, place_m: np.ndarray) -> Trajectory:
    wxyz = np.roll(Rotation.from_euler("ZYX", angles_rad).as_quat(), 1, axis=-1)
    return Trajectory(stamps_ns, SE3.from_parts(wxyz, place_m))


def wavy(stamps_ns: np.ndarray) -> Trajectory:
    """A robot on rough ground: 2 Hz of pitch and roll while it turns."""
    s = stamps_ns * 1e-9
    angles = np.stack([0.5 * s, 0.03 * np.sin(12 * s), 0.02 * np.cos(11 * s)], axis=-1)
    return track_through(stamps_ns, angles, np.stack([1.5 * s, 0.02 * np.sin(9 * s), 0.02 * np.cos(12 * s)], axis=-1))


def turned_deg(a: SE3, b: SE3) -> np.ndarray:
    between = (a.inverse() @ b).wxyz
    return np.rad2deg(2 * np.arctan2(np.linalg.norm(between[:, 1:], axis=1), np.abs(between[:, 0])))


@given(st.integers(0, 10_000))
@settings(max_examples=30, deadline=None)
def test_every_new_pose_is_on_the_polynomial_through_the_six_or_four_around_it(seed):
    generator = np.random.default_rng(seed)
    stamps_ns = np.cumsum(generator.integers(20_000_000, 90_000_000, 9))
    before = track_through(stamps_ns, generator.normal(0, 0.4, (9, 3)), generator.normal(0, 1, (9, 3)))
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
