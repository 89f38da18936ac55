"""Range images pixel by pixel, and votes in scenes where it is known what moved."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stone.geometry.se3 import SE3
from stone.surface.dynamic import FEWEST_MISSES, HITS, MotionVotes, carried_along, fewest_misses, is_moving
from stone.surface.range_image import (
    MAX_RING_GAP_PX,
    MAX_SPREAD_PX,
    DynamicParameters,
    RangeImage,
    _open_up,
    range_image,
    ring_spread_px,
    spread_px,
)

PARAMETERS = DynamicParameters()
SENSOR_EGO = np.array([0.2, 0.0, 1.2])
FARTHEST_M = np.float32(99.0)


def image_slowly(points):
    """The nearest return among those whose pixel is at most `spread_px` away, pixel by pixel; 0 where there is none."""
    rows, columns = PARAMETERS.shape
    ranges_m, spread = np.full((rows, columns), np.inf), spread_px(len(points))
    for x, y, z in points.astype(np.float64) - SENSOR_EGO:
        r = math.sqrt(x * x + y * y + z * z)
        row = math.floor((PARAMETERS.max_elevation_deg - math.degrees(math.asin(z / r))) / PARAMETERS.row_deg)
        column = math.floor((180 - math.degrees(math.atan2(y, x))) / PARAMETERS.column_deg)
        around = range(-spread, spread + 1)
        for i, j in [(row + di, (column + dj) % columns) for di in around for dj in around]:
            if 0 <= i < rows:
                ranges_m[i, j] = min(ranges_m[i, j], r)
    return np.where(np.isfinite(ranges_m), ranges_m, 0)


@pytest.mark.parametrize("seed", range(6))
def test_an_image_holds_the_nearest_return_of_each_direction(seed):
    points = np.random.default_rng(seed).uniform(-20, 20, (800, 3)).astype(np.float32)
    made = range_image(points, SE3.identity(), SENSOR_EGO, PARAMETERS).ranges_m
    np.testing.assert_allclose(made, image_slowly(points), atol=1e-4)


def test_dense_sweeps_fill_their_own_pixels_only_and_sparse_ones_those_around():
    assert spread_px(200_000) == 0
    assert spread_px(58_000) == 1
    assert spread_px(1) == spread_px(0) == MAX_SPREAD_PX
    widths = [spread_px(rays) for rays in range(0, 200_000, 500)]
    assert widths == sorted(widths, reverse=True)


def ringed_image(gap_px, rows=60, columns=20):
    nearest_m = np.full((rows, columns), np.inf, np.float32)
    nearest_m[::gap_px] = 5.0
    return nearest_m


def test_returns_reach_just_short_of_the_next_ring_so_that_each_pixel_holds_one_above_and_one_below():
    for gap_px in range(1, MAX_RING_GAP_PX + 1):
        assert ring_spread_px(ringed_image(gap_px)) == gap_px - 1
    assert ring_spread_px(ringed_image(MAX_RING_GAP_PX + 1)) == 0
    assert ring_spread_px(np.full((60, 20), np.inf, np.float32)) == 0


@pytest.mark.parametrize("seed", range(4))
def test_the_ring_gap_is_the_median_over_all_columns(seed):
    rng = np.random.default_rng(seed)
    nearest_m = np.where(rng.random((90, 40)) < rng.uniform(0.2, 0.9), 3.0, np.inf).astype(np.float32)
    gaps_px = np.sort(np.concatenate([np.diff(np.flatnonzero(np.isfinite(column))) for column in nearest_m.T]))
    assert ring_spread_px(nearest_m) == max(0, gaps_px[(len(gaps_px) - 1) // 2] - 1)


def opened_slowly(ranges):
    """The definition, pixel by pixel: empty runs longer than a ring gap, between the outermost rows of the image."""
    opened, filled = ranges.copy(), np.flatnonzero(ranges.any(axis=1))
    for column in range(ranges.shape[1]):
        rows = np.flatnonzero(ranges[filled[0] : filled[-1] + 1, column]) + filled[0]
        edges = [filled[0] - 1, *rows, filled[-1] + 1]
        for above, below in pairwise(edges if rows.size else []):
            if below - above - 1 > MAX_RING_GAP_PX:
                opened[above + 1 : below, column] = FARTHEST_M
    return opened


@pytest.mark.parametrize("seed", range(5))
def test_nothing_came_back_where_more_rows_are_empty_than_rings_leave_and_never_beyond_the_outermost(seed):
    rng = np.random.default_rng(seed)
    ranges = np.zeros((64, 40), np.float32)
    ranges[9:51, :35] = np.where(rng.random((42, 35)) < 0.12, rng.uniform(1.0, 30.0, (42, 35)), 0.0)
    opened = ranges.copy()
    _open_up(opened, FARTHEST_M)
    assert (opened == opened_slowly(ranges)).all()
    assert {0.0, float(FARTHEST_M)} < set(opened.flat)
    assert not opened[:9].any()
    assert not opened[51:].any()
    assert not opened[:, 35:].any()


WALL_X_M, BOX_X_M = 12.0, 6.0


def directions(step_deg=0.2, azimuth_deg=50):
    azimuth, elevation = np.meshgrid(
        np.radians(np.arange(-azimuth_deg, azimuth_deg, step_deg)), np.radians(np.arange(-25, 20, step_deg))
    )
    return np.stack([np.ones_like(azimuth), np.tan(azimuth), np.tan(elevation) / np.cos(azimuth)], -1).reshape(-1, 3)


def at_plane(x_map, pose):
    """Where rays of a level robot facing +x meet the plane x = x_map, in the ego frame."""
    return SENSOR_EGO + directions() * (x_map - (pose @ SENSOR_EGO)[0])


def is_box(points):
    return (np.abs(points[:, 1]) < 1) & (np.abs(points[:, 2] - 1.2) < 0.8)


def seen(pose, has_box):
    """One sweep of a wall, and of a box face before it."""
    wall, face = at_plane(WALL_X_M, pose), at_plane(BOX_X_M, pose)
    hit = is_box(pose @ face) if has_box else np.zeros(len(face), np.bool_)
    return np.where(hit[:, None], face, wall).astype(np.float32)


def robot_at(x):
    return SE3(np.array([1.0, 0, 0, 0, x, 0, 0]))


def votes_on(points_map, visits):
    images = (range_image(seen(robot_at(x), has_box), robot_at(x), SENSOR_EGO, PARAMETERS) for x, has_box in visits)
    return votes_by(points_map, images)


def votes_by(points_map, images):
    """The votes (N, 4) of images in the order of time."""
    motion = MotionVotes(points_map, PARAMETERS)
    for image in images:
        motion.add([image])
    return motion.counts()


def no_votes(points):
    return np.zeros((points, 4), np.int32)


def wall_points():
    y, z = np.meshgrid(np.arange(-4, 4, 0.2), np.arange(-0.5, 3, 0.2))
    return np.stack([np.full(y.size, WALL_X_M), y.ravel(), z.ravel()], axis=1)


def box_points():
    y, z = np.meshgrid(np.arange(-0.8, 0.81, 0.2), np.arange(0.6, 1.81, 0.2))
    return np.stack([np.full(y.size, BOX_X_M), y.ravel(), z.ravel()], axis=1)


@pytest.mark.parametrize(
    ("visits", "is_voted_out"),
    [
        ([(0.0, True), *((0.3 * i, False) for i in range(1, 7))], True),
        ([(0.2 * i, 3 <= i < 7) for i in range(10)], True),
        ([(0.2 * i, i >= 4) for i in range(10)], False),
        ([(0.2 * i, i % 2 == 0) for i in range(10)], False),
    ],
    ids=[
        "was there and went",
        "came, stood and went, seen half of the time",
        "came and stays",
        "seen through at times",
    ],
)
def test_a_box_that_went_is_voted_out_and_one_that_stays_is_kept(visits, is_voted_out):
    votes = votes_on(box_points(), visits)
    assert (is_moving(votes) == is_voted_out).all()
    assert not is_voted_out or visits[0][1] or (votes[:, HITS] >= 3).mean() > 0.9


def test_one_miss_is_enough_where_images_are_rare_and_nothing_was_hit():
    votes = np.array([[0, 1, 1, 1], [1, 2, 1, 1], [0, 0, 0, 0]], np.int32)
    assert is_moving(votes, fewest_misses(1.0)).tolist() == [True, False, False]
    assert not is_moving(votes, fewest_misses(0.2)).any()


def test_a_box_that_stays_is_kept():
    votes = votes_on(box_points(), [(0.3 * i, True) for i in range(7)])
    assert not is_moving(votes).any()
    assert (votes[:, 0] >= 5).mean() > 0.9


def test_a_wall_is_kept_though_a_box_hid_it_at_times():
    votes = votes_on(wall_points(), [(0.3 * i, i % 2 == 0) for i in range(8)])
    assert not is_moving(votes).any()
    assert not votes[:, 1].any()


def seen_under_sky(pose, has_box):
    """One sweep of a low wall, and of the box before it and before the sky above the wall."""
    points = seen(pose, has_box)
    return points[((pose @ points.astype(np.float64))[:, 2] < 0.5) | (points[:, 0] < WALL_X_M - 3)]


def votes_under_sky(points_map, visits):
    images = []
    for x, has_box in visits:
        pose = robot_at(x)
        above = pose.inverse() @ np.array([[WALL_X_M, 0.0, 4.0]])  # a branch: rays do go up there
        points = np.concatenate([seen_under_sky(pose, has_box), above.astype(np.float32)])
        images.append(range_image(points, pose, SENSOR_EGO, PARAMETERS))
    return votes_by(points_map, images)


@pytest.mark.parametrize("stays", [False, True])
def test_what_stood_before_the_sky_is_voted_out_if_it_went_and_kept_if_it_stays(stays):
    votes = votes_under_sky(box_points(), [(0.0, True), *((0.3 * i, stays) for i in range(1, 7))])
    assert (is_moving(votes) != stays).all()


def test_where_no_ray_went_nothing_is_voted():
    behind = wall_points() * [-1, 1, 1]
    above = wall_points() + np.array([0, 0, 30])
    hidden = wall_points() + np.array([5, 0, 0])
    for points in (behind, above, hidden):
        assert not votes_on(points, [(0.3 * i, False) for i in range(8)]).any()


@pytest.mark.parametrize("count", [1, 1023, 1024, 1025])
def test_points_far_apart_and_not_a_whole_block_are_judged_each_in_its_place(count):
    rng = np.random.default_rng(count)
    near = rng.random(count) < 0.5
    points = np.where(near[:, None], [5.0, 0.0, 0.0], [500.0, 0.0, 0.0]) + rng.uniform(-1, 1, (count, 3))
    image = range_image((directions() * 60).astype(np.float32), robot_at(0), np.zeros(3), PARAMETERS)
    np.testing.assert_array_equal(votes_by(points, [image])[:, 1], near)


def test_points_out_of_reach_are_not_judged():
    reach = PARAMETERS.max_range_m
    image = range_image((directions() * 60).astype(np.float32), robot_at(0), np.zeros(3), PARAMETERS)
    points = np.array([[reach + 0.1, 0, 0], [0.9, 0, 0], [reach - 0.1, 0, 0], [1.1, 0, 0]])
    votes = votes_by(points, [image])
    assert votes.tolist() == [[0, 0, 0, 0], [0, 0, 0, 0], [0, 1, 1, 1], [0, 1, 1, 1]]


def vote_slowly(point_view, ranges_m):
    """(hits, misses) of one point seen from the image's own place, and how near a border of pixels it is (pixels)."""
    (x, y, z), r = point_view, math.dist(point_view, (0, 0, 0))
    row = (PARAMETERS.max_elevation_deg - math.degrees(math.asin(z / r))) / PARAMETERS.row_deg
    column = (180 - math.degrees(math.atan2(y, x))) / PARAMETERS.column_deg
    (rows, columns), border_px = ranges_m.shape, min(abs(row - round(row)), abs(column - round(column)))
    i, j = math.floor(row), math.floor(column) % columns
    if not PARAMETERS.min_range_m <= r < PARAMETERS.max_range_m or not 1 <= i < rows - 1:
        return (0, 0), border_px
    around = [ranges_m[i + di, (j + dj) % columns] for di in (-1, 0, 1) for dj in (-1, 0, 1)]
    if min(around) > r + PARAMETERS.margin_m:
        return (0, 1), border_px
    return (int(abs(ranges_m[i, j] - r) < PARAMETERS.margin_m), 0), border_px


def summed_slowly(verdicts):
    """The columns of votes, of (hit, miss) in the order of time."""
    hits = [at for at, (hit, _) in enumerate(verdicts) if hit]
    misses = [at for at, (_, miss) in enumerate(verdicts) if miss]
    first, last = (hits[0], hits[-1]) if hits else (len(verdicts), -1)
    return len(hits), len(misses), sum(at < first for at in misses), sum(at > last for at in misses)


@pytest.mark.parametrize("seed", range(3))
def test_votes_are_those_of_each_point_on_its_own(seed):
    rng = np.random.default_rng(seed)
    blocks = rng.choice([0.0, 5.0, 8.0, 11.0, 14.0, 17.0, 25.0], (3, 10, 15))
    images = blocks.repeat(13, axis=1).repeat(60, axis=2).astype(np.float32)
    points = rng.normal(size=(3000, 3)) * [10, 10, 3]
    view = SE3.from_parts(rng.normal(size=4), rng.normal(size=3))
    votes = votes_by(view @ points, [RangeImage(view, ranges_m) for ranges_m in images])
    slow = [[vote_slowly(point, ranges_m) for ranges_m in images] for point in points.tolist()]
    clear = np.array([verdicts[0][1] > 1e-4 for verdicts in slow])
    assert clear.mean() > 0.99
    expected = np.array([summed_slowly([verdict for verdict, _ in verdicts]) for verdicts in slow])
    np.testing.assert_array_equal(votes[clear], expected[clear])
    assert (votes.sum(axis=0) > 20).all()


@settings(max_examples=10, deadline=None)
@given(st.floats(-math.pi, math.pi), st.floats(-500, 500), st.floats(-500, 500))
def test_moving_and_yawing_the_world_moves_no_vote_off_its_point(yaw, x, y):
    world = SE3(np.array([math.cos(yaw / 2), 0, 0, math.sin(yaw / 2), x, y, 3.0]))
    image = range_image(seen(robot_at(0), False), world @ robot_at(0), SENSOR_EGO, PARAMETERS)
    votes = votes_by(world @ box_points(), [image])
    assert (votes == votes_on(box_points(), [(0.0, False)])).all()


def test_it_takes_more_than_twice_as_many_misses_as_hits():
    hits_and_misses = np.array([[0, FEWEST_MISSES - 1], [0, FEWEST_MISSES], [2, 4], [2, 5], [0, 0]], np.int32)
    votes = np.concatenate([hits_and_misses, np.zeros((5, 2), np.int32)], axis=1)  # all misses between two hits
    assert is_moving(votes).tolist() == [False, True, False, True, False]


def fan(rings):
    """Unit rays of a LiDAR with so many rings from 15° to −25°."""
    azimuth, elevation = np.meshgrid(np.radians(np.arange(-40, 40, 0.2)), np.radians(np.linspace(15, -25, rings)))
    flat = np.cos(elevation)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], -1).reshape(-1, 3)


def empty_plain(rings):
    """One sweep of level ground at z = 0 with a hazy end at 40 m, in the ego frame."""
    rays = fan(rings)
    reach = np.minimum(40.0, np.where(rays[:, 2] < 0, -SENSOR_EGO[2] / np.minimum(rays[:, 2], -1e-9), 40.0))
    return (SENSOR_EGO + rays * reach[:, None]).astype(np.float32)


def votes_on_the_plain(points_map, rings):
    places = (robot_at(x) for x in np.arange(0.0, 4.0, 0.4))
    return votes_by(points_map, (range_image(empty_plain(rings), at, SENSOR_EGO, PARAMETERS) for at in places))


@pytest.mark.parametrize("rings", [16, 32, 64, 128])
def test_who_left_is_voted_out_and_the_ground_is_not_however_few_rings_look(rings):
    z, y = np.meshgrid(np.arange(0.8, 1.7, 0.1), np.arange(-0.2, 0.21, 0.1))
    person = np.stack([np.full(z.size, 8.0), y.ravel(), z.ravel()], axis=1)
    assert is_moving(votes_on_the_plain(person, rings)).all()
    x, y = np.meshgrid(np.arange(3.0, 14.0, 0.1), np.arange(-1.5, 1.51, 0.1))
    ground = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    assert not is_moving(votes_on_the_plain(ground, rings)).any()


def test_what_was_hardly_seen_and_touches_what_moved_moved_too():
    """A column of points 0.09 m apart whose lower half was voted out: the head goes with it, a wall's top would not."""
    points = np.column_stack([np.zeros(12), np.zeros(12), 0.09 * np.arange(12)])
    moving, votes = np.arange(12) < 6, no_votes(12)
    seldom = carried_along(points, np.full(12, 3), votes, moving)
    np.testing.assert_array_equal(seldom, np.arange(12) < 10)  # two touches of 0.2 m, and no farther
    often = carried_along(points, np.full(12, 40), votes, moving)
    np.testing.assert_array_equal(often, moving)
    vouched = carried_along(points, np.full(12, 3), votes + np.array([3, 0, 0, 0], np.int32), moving)
    np.testing.assert_array_equal(vouched, moving)


def test_where_nothing_moved_nothing_is_carried_along():
    points = np.random.default_rng(0).uniform(size=(50, 3))
    none = np.zeros(50, np.bool_)
    assert not carried_along(points, np.ones(50, np.int64), no_votes(50), none).any()
    assert len(carried_along(points[:0], np.ones(0, np.int64), no_votes(0), none[:0])) == 0


@pytest.mark.parametrize(("farthest_m", "is_seen_through"), [(6.0, False), (11.0, False), (20.0, True)])
def test_what_lies_farther_than_the_sensor_sees_is_not_looked_through(farthest_m, is_seen_through):
    """Ground near the robot and branches above it, no return between: sky, if the sensor sees as far as the wall."""
    rays = directions() / np.linalg.norm(directions(), axis=1, keepdims=True)
    elevation_deg = np.degrees(np.arcsin(rays[:, 2]))
    points = (SENSOR_EGO + 5.0 * rays)[(elevation_deg < -15) | (elevation_deg > 15)]
    points[0] = SENSOR_EGO + np.array([0.0, farthest_m, 0.0])  # to the side, beside nothing else
    image = range_image(points.astype(np.float32), robot_at(0), SENSOR_EGO, PARAMETERS)
    assert votes_by(wall_points(), [image]).any() == is_seen_through
