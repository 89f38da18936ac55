"""Sweeps: which points are of the world, and where each would be seen at the stamp, one at a time by scipy."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from stone.errors import ShapeError
from stone.geometry.se3 import SE3
from stone.geometry.trajectory import Trajectory
from stone.sensors.calibration import Box
from stone.sensors.deskew import BIN_NS, SweepMount, deskew, sweep_motion
from stone.sensors.reach import FARTHEST_POINT_M
from stone.sensors.selection import AT_ONCE, selected, world_points
from testing.refusals import refused_as

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


HOSTILE = (math.nan, math.inf, -math.inf, 0.0, 1e-45, -1e-30, 1.0, -3.0, 700.0, 1e3, 1e19, -1e30, 1e38, 3e38, -3e38)


@settings(max_examples=50, deadline=None)
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


STAMP_NS = 1_760_000_000_000_000_000
SWEEP_NS = 100_000_000
SPEED_M_S, YAW_RATE_RAD_S = 4.8, np.deg2rad(28)


def arc(times_ns):
    """Exact `map_from_ego` of a robot on a circle: 4.8 m/s, 28 °/s, level."""
    seconds = (np.asarray(times_ns) - STAMP_NS) * 1e-9
    yaw, radius_m = YAW_RATE_RAD_S * seconds, SPEED_M_S / YAW_RATE_RAD_S
    wxyz = np.stack([np.cos(yaw / 2), 0 * yaw, 0 * yaw, np.sin(yaw / 2)], axis=-1)
    return SE3.from_parts(wxyz, np.stack([radius_m * np.sin(yaw), radius_m * (1 - np.cos(yaw)), 0 * yaw], axis=-1))


def driven(first_ns=-100_000_000, last_ns=300_000_000, step_ns=1_000_000, ego_from_lidar=EGO_FROM_LIDAR):
    stamps_ns = STAMP_NS + np.arange(first_ns, last_ns + 1, step_ns, dtype=np.int64)
    return SweepMount(Trajectory(stamps_ns, arc(stamps_ns)), ego_from_lidar)


def scattered(count, seed=0):
    rng = np.random.default_rng(seed)
    return rng.uniform(-25, 25, (count, 3)).astype(np.float32), rng.integers(0, SWEEP_NS, count)


def deskewed_slowly(points, offset_ns, mount):
    """One scipy pose per point, float64."""
    path = mount.trajectory
    seconds = (path.stamps_ns - STAMP_NS) * 1e-9
    turn = Slerp(seconds, Rotation.from_quat(np.roll(path.map_from_ego.wxyz, -1, axis=-1)))
    lever, mounted = mount.ego_from_lidar.translation_m, Rotation.from_quat(np.roll(mount.ego_from_lidar.wxyz, -1))

    def position(at_s):
        return np.array([np.interp(at_s, seconds, path.map_from_ego.translation_m[:, i]) for i in range(3)])

    moved = []
    for point, offset in zip(points.astype(np.float64), offset_ns, strict=True):
        at_s = offset * 1e-9
        in_map = turn(at_s).apply(mounted.apply(point) + lever) + position(at_s)
        in_ego = turn(0.0).inv().apply(in_map - position(0.0))
        moved.append(mounted.inv().apply(in_ego - lever))
    return np.array(moved)


def motion_slowly(mount, stamp_ns, span_ns):
    """`stamp_from_bin` of each bin by the trajectory and transforms themselves, one after the other."""
    first, last = ((offset + BIN_NS // 2) // BIN_NS for offset in span_ns)
    whole = []
    for time_ns in [stamp_ns, *(stamp_ns + b * BIN_NS for b in range(first, last + 1))]:
        found = mount.trajectory.at(np.array([time_ns]), mount.max_gap_ns)
        whole.append((found.map_from_ego[0] @ mount.ego_from_lidar, bool(found.is_ok[0]), int(found.segment[0])))
    stamp, *bins = whole
    has_pose = [stamp[1] and is_ok and segment == stamp[2] for _, is_ok, segment in bins]
    return first, [stamp[0].inverse() @ at if ok else None for (at, _, _), ok in zip(bins, has_pose, strict=True)]


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32), st.sampled_from([4_000_000, 40_000_000, 250_000_000]), st.booleans())
def test_the_motion_of_a_sweep_is_what_the_trajectory_says_bin_by_bin(seed, max_gap_ns, is_split):
    rng = np.random.default_rng(seed)
    stamps_ns = STAMP_NS + np.cumsum(rng.choice([1_000_000, 3_000_000, 5_000_000, 60_000_000], 12)) - 60_000_000
    poses = SE3.from_parts(rng.normal(size=(12, 4)), rng.uniform(-300, 300, (12, 3)))
    track = Trajectory(stamps_ns, poses, np.arange(12) // 5 if is_split else None)
    mount = SweepMount(track, EGO_FROM_LIDAR, max_gap_ns)
    stamp_ns = int(rng.choice(stamps_ns[2:])) + int(rng.choice([0, 7]))
    span_ns = -int(rng.integers(0, 9_000_000)), int(rng.integers(0, 9_000_000))
    made = sweep_motion(mount, stamp_ns, span_ns)
    first, expected = motion_slowly(mount, stamp_ns, span_ns)
    assert made.first_bin == first
    assert made.has_pose.tolist() == [at is not None for at in expected]
    for b, at in enumerate(expected):
        if at is not None:
            np.testing.assert_allclose(made.rotation[b], at.rotation(), atol=1e-7)
            np.testing.assert_allclose(made.translation_m[b], at.translation_m, rtol=2e-7, atol=1e-10)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32))
def test_the_order_of_points_in_a_sweep_does_not_matter(seed):
    """Neighbours of one bin are moved together, wherever they stand."""
    points, offset_ns = scattered(500, seed)
    shuffled = np.random.default_rng(seed).permutation(500)
    mount = driven(first_ns=-10_000_000, last_ns=60_000_000)
    in_order = np.argsort(offset_ns, kind="stable")
    sorted_first = deskew(points[in_order], offset_ns[in_order], mount, STAMP_NS)
    moved = deskew(points[shuffled], offset_ns[shuffled], mount, STAMP_NS)
    assert 0 < len(moved) < 500
    assert sorted(map(tuple, moved.tolist())) == sorted(map(tuple, sorted_first.tolist()))


@settings(max_examples=5, deadline=None)
@given(st.integers(0, 2**32))
def test_every_point_is_within_two_millimetres_of_its_own_exact_pose(seed):
    points, offset_ns = scattered(300, seed)
    mount = driven(step_ns=50_000_000)
    moved = deskew(points, offset_ns, mount, STAMP_NS)
    assert moved.dtype == np.float32
    off_m = np.linalg.norm(moved - deskewed_slowly(points, offset_ns, mount), axis=1)
    # Half a bin: 50 µs × (4.8 m/s + 28 °/s × the reach of a corner of the cube, 43 m).
    assert off_m.max() < 50e-6 * (SPEED_M_S + YAW_RATE_RAD_S * 45) + 1e-5


def test_a_wall_passed_in_a_turn_becomes_flat_where_it_was_curved():
    """The robot drives and turns past the wall y = 8 m; each point is measured from where the LiDAR then was."""
    mount = driven()
    offset_ns = np.arange(0, SWEEP_NS, 50_000, dtype=np.int64)
    wall_map = np.stack(
        [np.linspace(-20, 20, len(offset_ns)), np.full(len(offset_ns), 8.0), np.ones(len(offset_ns))], 1
    )
    map_from_lidar = arc(STAMP_NS + offset_ns) @ EGO_FROM_LIDAR
    points = (map_from_lidar.inverse() @ wall_map).astype(np.float32)
    map_from_stamp = arc(STAMP_NS) @ EGO_FROM_LIDAR
    moved = map_from_stamp @ deskew(points, offset_ns, mount, STAMP_NS).astype(np.float64)
    raw = map_from_stamp @ points.astype(np.float64)
    assert np.abs(raw[:, 1] - 8.0).max() > 0.5
    np.testing.assert_allclose(moved, wall_map, atol=1.3e-3)


def test_points_at_the_stamp_stay_and_negative_times_are_measured_before_it():
    points = np.array([[10.0, 0, 0], [10.0, 0, 0]], np.float32)
    offset_ns = np.array([0, -SWEEP_NS], np.int64)
    moved = deskew(points, offset_ns, driven(ego_from_lidar=SE3.identity()), STAMP_NS)
    np.testing.assert_array_equal(moved[0], points[0])
    oracle = arc(STAMP_NS - SWEEP_NS) @ np.array([10.0, 0, 0])
    np.testing.assert_allclose(moved[1], oracle, atol=1e-3)


def test_points_without_a_pose_are_dropped_and_the_others_keep_their_order():
    points, offset_ns = scattered(1000)
    cut = driven(last_ns=60_000_000, step_ns=20_000_000)
    whole = deskew(points, offset_ns, driven(step_ns=20_000_000), STAMP_NS)
    kept = (offset_ns + 50_000) // 100_000 * 100_000 <= 60_000_000
    moved = deskew(points, offset_ns, cut, STAMP_NS)
    assert 0 < kept.sum() < 1000
    np.testing.assert_array_equal(moved, whole[kept])


def test_a_sweep_whose_stamp_has_no_pose_keeps_nothing():
    points, offset_ns = scattered(10)
    assert deskew(points, offset_ns, driven(first_ns=10_000_000), STAMP_NS).shape == (0, 3)
    assert deskew(points[:0], offset_ns[:0], driven(), STAMP_NS).shape == (0, 3)


def test_implausible_inputs_are_refused():
    points, offset_ns = scattered(4)
    with refused_as("point_offset"):
        deskew(points, offset_ns + STAMP_NS, driven(), STAMP_NS)
    with pytest.raises(ShapeError):
        deskew(points, offset_ns[:3], driven(), STAMP_NS)
    with pytest.raises(ShapeError):
        deskew(points[:, :2], offset_ns, driven(), STAMP_NS)


@pytest.mark.parametrize("far_m", [2e3, 1e12, 1e300, np.inf])
def test_where_the_robot_was_moved_out_of_reach_within_a_sweep_there_is_no_pose(far_m):
    """At a steady speed no step is a jump, however fast it is."""
    stamps_ns = STAMP_NS + np.array([0, SWEEP_NS], np.int64)
    poses = SE3.from_parts(np.tile([1.0, 0, 0, 0], (2, 1)), np.array([[0.0, 0, 0], [far_m, 0, 0]]))
    mount = SweepMount(Trajectory(stamps_ns, poses), SE3.identity())
    with np.errstate(all="ignore"):
        moved = deskew(np.ones((11, 3), np.float32), np.arange(11) * SWEEP_NS // 10, mount, STAMP_NS)
    assert 1 <= len(moved) < 11
    assert (np.abs(moved) < 1010).all()
