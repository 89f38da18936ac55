"""Interpolation against scipy, and where it answers with a reason instead of a pose."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from stone.errors import ShapeError
from stone.geometry.se3 import SE3
from stone.geometry.trajectory import EmptyTrajectoryError, PoseStatus, Trajectory, TrajectoryStampsError

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


def test_a_pose_on_the_edge_of_a_gap_still_counts():
    stamps_ns = T0_NS + np.array([0, 10_000_000_000])
    found = Trajectory(stamps_ns, SE3.identity((2,))).at(stamps_ns)
    assert found.is_ok.all()


def test_a_single_pose_answers_for_its_stamp_only():
    found = Trajectory(np.array([T0_NS]), SE3.identity((1,))).at(T0_NS + np.array([-1, 0, 1]))
    assert found.status.tolist() == [PoseStatus.BEFORE_FIRST, PoseStatus.OK, PoseStatus.AFTER_LAST]


@settings(max_examples=30, deadline=None)
@given(st.permutations(range(12)))
def test_the_order_of_queries_does_not_matter(order):
    trajectory, _, _ = wandering(6)
    query_ns = T0_NS - STEP_NS + np.arange(12) * (STEP_NS * 2 // 3)
    straight, shuffled = trajectory.at(query_ns), trajectory.at(query_ns[list(order)])
    np.testing.assert_array_equal(straight.map_from_ego.wxyz_xyz[list(order)], shuffled.map_from_ego.wxyz_xyz)
    np.testing.assert_array_equal(straight.status[list(order)], shuffled.status)


def test_what_is_no_trajectory_is_refused():
    with pytest.raises(TrajectoryStampsError, match="pose 2 is 0 ns after"):
        Trajectory(T0_NS + np.array([0, 1, 1]), SE3.identity((3,)))
    with pytest.raises(EmptyTrajectoryError, match="0 poses"):
        Trajectory(np.array([], np.int64), SE3.identity((0,)))
    with pytest.raises(ShapeError, match=r"one pose per stamp \(2,\)"):
        Trajectory(T0_NS + np.array([0, 1]), SE3.identity((3,)))
