"""Which points are of the world, against numpy masks."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stone.geometry.se3 import SE3
from stone.sensors.calibration import Box
from stone.sensors.reach import FARTHEST_POINT_M
from stone.sensors.selection import AT_ONCE, selected, world_points

EGO_FROM_LIDAR = SE3.from_parts(np.array([0.9, 0.1, -0.2, 0.3]), np.array([0.3, -0.1, 1.2]))
BOXES = (Box((-1.0, -0.5, 0.0), (1.5, 0.5, 2.0)), Box((-3.0, -3.0, -1.0), (-2.0, 3.0, 1.0)))


def inside(points, box):
    return ((points >= box.min_m) & (points < box.max_m)).all(axis=1)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32), st.floats(0, 3))
def test_world_points_are_far_enough_and_outside_every_box(seed, min_range_m):
    points = np.random.default_rng(seed).uniform(-4, 4, (500, 3)).astype(np.float32)
    points_ego = EGO_FROM_LIDAR @ points.astype(np.float64)
    near = (points.astype(np.float64) ** 2).sum(axis=1) < min_range_m**2
    expected = points_ego[~near & ~inside(points_ego, BOXES[0]) & ~inside(points_ego, BOXES[1])]
    made = world_points(points, EGO_FROM_LIDAR, BOXES, min_range_m)
    np.testing.assert_allclose(made, expected, atol=1e-6)
    assert made.dtype == np.float32


def test_without_boxes_the_range_alone_decides():
    points = np.array([[0.5, 0, 0], [2.0, 0, 0]], np.float32)
    assert world_points(points, SE3.identity(), (), 1.0).tolist() == [[2.0, 0, 0]]


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32), st.integers(0, 5))
def test_points_beside_far_ones_are_looked_at_as_closely(seed, near_each):
    """Points far from the robot are turned many at a time; none that is near may pass with them."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(20, 60, (700, 3)).astype(np.float32)
    for begin in range(0, 700, 100):
        points[begin + rng.integers(0, 100, near_each)] = rng.uniform(-2, 2, (near_each, 3))
    one_by_one = [world_points(point[None], EGO_FROM_LIDAR, BOXES, 1.0) for point in points]
    assert world_points(points, EGO_FROM_LIDAR, BOXES, 1.0).tobytes() == np.concatenate(one_by_one).tobytes()


def test_points_that_are_not_numbers_are_not_of_the_world():
    points = np.array([[math.nan, 0, 9], [9, 0, 0]], np.float32)
    assert world_points(points, SE3.identity(), (), 1.0).tolist() == [[9, 0, 0]]


@pytest.mark.parametrize("count", [0, 1, AT_ONCE - 1, AT_ONCE, AT_ONCE + 1, 3 * AT_ONCE])
def test_the_robots_own_points_follow_those_of_the_world_and_none_in_reach_is_lost(count):
    points = np.random.default_rng(count).uniform(-4, 4, (count, 3)).astype(np.float32)
    points[::50] = math.nan
    made = selected(points, EGO_FROM_LIDAR, BOXES, 1.0)
    world, everything = (world_points(points, EGO_FROM_LIDAR, *rest) for rest in ((BOXES, 1.0), ((), 0.0)))
    assert made.world_ego.tobytes() == world.tobytes()
    assert sorted(made.points_ego.tolist()) == sorted(everything.tolist())
    assert len(everything) == np.isfinite(points).all(axis=1).sum()


def test_a_box_is_half_open():
    points = np.array([[-1, 9, 1], [1.5, 9, 1], [-1.1, 9, 1]], np.float32)
    assert world_points(points, SE3.identity(), (Box((-1, 9, 1), (1.5, 10, 2)),), 0.0).tolist() == points[1:].tolist()


def test_no_points_stay_none():
    none = np.zeros((0, 3), np.float32)
    assert world_points(none, EGO_FROM_LIDAR, BOXES, 1.0).shape == (0, 3)


HOSTILE = (math.nan, math.inf, -math.inf, 0.0, 1e-45, -1e-30, 1.0, -3.0, 700.0, 1e3, 1e19, -1e30, 1e38, 3e38, -3e38)


@settings(max_examples=100, deadline=None)
@given(st.lists(st.tuples(*[st.sampled_from(HOSTILE)] * 3), min_size=1, max_size=80), st.floats(-math.pi, math.pi))
def test_whatever_a_point_is_no_later_one_is_out_of_reach(rows, yaw_rad):
    """Under a yaw of 45° (3e38, -3e38, 5) was infinite, which wrote outside of an array later on."""
    mount = SE3.from_parts(np.array([math.cos(yaw_rad / 2), 0, 0, math.sin(yaw_rad / 2)]), np.array([99.0, 0, 5.0]))
    for boxes in ((), BOXES):
        made = world_points(np.array(rows, np.float32), mount, boxes, 1.0)
        assert (np.linalg.norm(made - mount.translation_m, axis=1) <= FARTHEST_POINT_M * 1.001).all()


def test_a_box_around_everything_leaves_nothing():
    endless = Box((-1e300, -1e300, -1e300), (1e300, 1e300, 1e300))
    points = np.array([[0, 0, 2.0], [900.0, 0, 0]], np.float32)
    assert world_points(points, EGO_FROM_LIDAR, (endless,), 1.0).shape == (0, 3)
