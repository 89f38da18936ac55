"""The ground: low points of cells, its plane around the robot, and the drift in z that it tells."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from stone.geometry.lattice import keys_of
from stone.geometry.se3 import SE3
from stone.sensors.ground_links import (
    FEWEST_CELLS,
    MANY_LOOKS,
    WIDEST_SPACING_M,
    Look,
    Way,
    drift,
    driven,
    links_between,
    look,
    looks_along,
)
from stone.sensors.ground_plane import GroundFit, ground_fit
from stone.sensors.ground_points import FEWEST_IN_CELL, LOW_QUANTILE, around_robot, low_points, plane_around
from stone.sensors.height_drift import TOLERATED_M


def low_points_slowly(points, cell):
    by_cell = {}
    for row, one in enumerate(cell.tolist()):
        by_cell.setdefault(one, []).append(row)
    full = {one: rows for one, rows in sorted(by_cell.items()) if len(rows) >= FEWEST_IN_CELL}
    ranked = {one: sorted(rows, key=lambda row: (points[row, 2], row)) for one, rows in full.items()}
    return list(full), [points[rows[int(LOW_QUANTILE * (len(rows) - 1))]].tolist() for rows in ranked.values()]


@given(st.lists(st.tuples(st.integers(0, 4), st.integers(-3, 3)), max_size=60))
def test_the_low_point_of_a_cell_is_that_of_the_sorted_ones_and_the_first_of_equals(rows):
    cell = np.array([one for one, _ in rows], np.int64) * 10**12
    points = np.array([(at, -at, height / 2) for at, (_, height) in enumerate(rows)], np.float64).reshape(-1, 3)
    cells, lowest = low_points(points, cell)
    assert (cells.tolist(), lowest.tolist()) == low_points_slowly(points, cell)


@pytest.mark.parametrize("order", ["up", "down", "equal", "random"])
def test_the_order_that_points_come_in_changes_no_low_point(order):
    rng = np.random.default_rng(3)
    heights = {
        "up": np.arange(5000.0),
        "down": -np.arange(5000.0),
        "equal": np.zeros(5000),
        "random": rng.normal(size=5000),
    }[order]
    points, cell = np.column_stack([np.arange(5000.0), np.zeros(5000), heights]), rng.integers(0, 40, 5000)
    cells, lowest = low_points(points, cell)
    assert (cells.tolist(), lowest.tolist()) == low_points_slowly(points, cell)


def test_points_around_the_robot_are_those_of_their_distance_and_height_in_their_order():
    rng = np.random.default_rng(1)
    points = (rng.normal(size=(5000, 3)) * [9, 9, 2]).astype(np.float32)
    near = [row for row in points.tolist() if 0.8 <= math.hypot(*row[:2]) <= 12.0 and -2.5 <= row[2] <= 1.5]
    assert 1000 < len(near) < 5000
    assert around_robot(points).tolist() == near
    assert around_robot(points[:0]).shape == (0, 3)


def test_at_a_limit_of_distance_the_distance_itself_decides():
    limits = [12.0, math.nextafter(12.0, 13.0), math.nextafter(12.0, 0.0), 0.8, math.nextafter(0.8, 0.0)]
    points = np.array([[limit * part for part in (0.6, 0.8)] + [0.0] for limit in limits for _ in range(3)])
    near = [row for row in points.tolist() if 0.8 <= np.hypot(*row[:2]) <= 12.0]
    assert around_robot(points).tolist() == near
    assert 0 < len(near) < len(points)


def ground(height_m=0.0, slope_x=0.0, slope_y=0.0, noise_m=0.02, seed=0, sides=(-10.0, 10.0)):
    rng = np.random.default_rng(seed)
    plan = rng.uniform(*sides, (20_000, 2))
    z = height_m + plan @ [slope_x, slope_y] + noise_m * rng.standard_normal(len(plan))
    return np.column_stack([plan, z]).astype(np.float32)


def wall(seed=1):
    rng = np.random.default_rng(seed)
    return rng.uniform([1.5, -8.0, -0.2], [1.8, 8.0, 1.4], (8_000, 3)).astype(np.float32)


def grass(seed=2):
    """Blades up to 0.4 m on half of what is around."""
    rng = np.random.default_rng(seed)
    return rng.uniform([-6.0, 0.0, 0.0], [6.0, 6.0, 0.4], (4_000, 3)).astype(np.float32)


def plane(points):
    found = plane_around(points)
    assert found is not None
    return found


@settings(max_examples=20, deadline=None)
@given(st.floats(-0.6, 0.6), st.floats(-0.12, 0.12), st.floats(-0.12, 0.12), st.integers(0, 100))
def test_a_plane_is_found_to_two_centimetres_and_a_third_of_a_degree(height_m, slope_x, slope_y, seed):
    found = plane(ground(height_m, slope_x, slope_y, seed=seed))
    assert found[0] == pytest.approx(height_m, abs=0.02)
    assert found[1:] == pytest.approx([slope_x, slope_y], abs=0.006)


@pytest.mark.parametrize("clutter", [wall(), grass()], ids=["wall", "grass"])
def test_what_stands_on_the_ground_is_not_taken_for_it(clutter):
    found = plane(np.concatenate([ground(-0.3), clutter]))
    assert found[0] == pytest.approx(-0.3, abs=0.03)


@pytest.mark.parametrize(
    "points",
    [
        np.zeros((0, 3), np.float32),
        ground(sides=(1.0, 6.0)),
        wall(),
        np.full((5_000, 3), np.nan, np.float32),
        np.random.default_rng(3).uniform([-6, -6, -2], [6, 6, 1.4], (500, 3)).astype(np.float32),
    ],
    ids=["nothing", "one side", "a wall", "no numbers", "rain"],
)
def test_what_is_no_ground_all_around_gives_none(points):
    assert plane_around(points) is None


def test_a_run_is_told_by_the_middle_of_its_sweeps():
    planes = [np.array([0.02 * number, 0.0, 0.01]) for number in range(-4, 5)] + [np.array([3.0, 0.3, 0.3])]
    fit = ground_fit(planes)
    assert fit is not None
    assert fit.sweeps == 10
    assert fit.height_m == pytest.approx(0.01, abs=0.02)
    assert (fit.slope_x, fit.slope_y) == pytest.approx((0.0, 0.01))
    assert ground_fit(planes[:4]) is None


@pytest.mark.parametrize(("height_m", "slope_x", "slope_y"), [(-0.23, 0.0, 0.0), (0.5, 0.05, -0.04), (0.0, 0.0, 0.06)])
def test_with_the_corrected_mount_the_ground_is_where_it_should_be(height_m, slope_x, slope_y):
    mount = SE3.from_parts(np.array([0.99, 0.02, -0.03, 0.1]), np.array([0.3, -0.1, 1.6]))
    fit = GroundFit(40, height_m, slope_x, slope_y, height_m, height_m)
    seen_lidar = mount.inverse() @ ground(height_m, slope_x, slope_y).astype(np.float64)
    found = plane((fit.corrected(mount) @ seen_lidar).astype(np.float32))
    assert np.abs(found) == pytest.approx(np.zeros(3), abs=0.02)


@pytest.mark.parametrize("heading_rad", [0.0, 1.5, -2.5])
def test_a_corrected_mount_stays_where_it_was_in_plan_and_looks_where_it_looked(heading_rad):
    wxyz = np.array([np.cos(heading_rad / 2), 0.01, -0.02, np.sin(heading_rad / 2)])
    mount = SE3.from_parts(wxyz, np.array([0.3, -0.1, 1.6]))
    right = GroundFit(40, 0.4, 0.05, -0.04, 0.4, 0.4).corrected(mount)
    assert right.translation_m[:2].tolist() == [0.3, -0.1]
    ahead, ahead_before = (one.rotation()[:2, 0] for one in (right, mount))
    assert np.arctan2(*ahead[::-1]) == pytest.approx(np.arctan2(*ahead_before[::-1]), abs=1e-9)


def test_a_mount_that_looks_up_is_turned_as_little_as_can_be():
    """Its x axis has no heading in plan."""
    mount = SE3.from_parts(np.array([np.sqrt(0.5), 0.0, -np.sqrt(0.5), 0.0]), np.array([0.0, 0.0, 1.0]))
    right = GroundFit(40, 0.0, 0.05, 0.0, 0.0, 0.0).corrected(mount)
    turned = right @ mount.inverse()
    assert 2 * np.linalg.norm(turned.wxyz[1:]) == pytest.approx(np.arctan(0.05), rel=0.01)


def test_what_stands_close_beside_the_robot_is_not_its_ground():
    """Two cars beside it fill little of the plan around it, and lie nearer than the road that the LiDAR sees."""
    rng = np.random.default_rng(3)
    road = np.column_stack([rng.uniform(-9, 9, (60_000, 2)), rng.normal(0.0, 0.01, 60_000)])
    road = road[np.hypot(road[:, 0], road[:, 1]) > 4.0]
    cars = np.column_stack([rng.uniform(-1.5, 1.5, 3000), rng.uniform(2.0, 2.5, 3000), rng.normal(0.9, 0.01, 3000)])
    behind = cars * np.array([1.0, -1.0, 1.0])
    found = plane(np.concatenate([road, cars, behind]).astype(np.float32))
    assert np.abs(found) == pytest.approx(np.zeros(3), abs=0.02)


def test_terrain_is_not_corrected_away():
    assert GroundFit(40, 0.05, 0.02, 0.0, 0.0, 0.1).beyond_terrain() == GroundFit(40, 0.0, 0.0, 0.0, 0.0, 0.1)
    assert GroundFit(40, 0.23, 0.02, 0.0, 0.2, 0.3).beyond_terrain() == GroundFit(40, 0.23, 0.0, 0.0, 0.2, 0.3)
    assert GroundFit(40, 0.05, 0.06, 0.0, 0.0, 0.1).beyond_terrain() == GroundFit(40, 0.0, 0.06, 0.0, 0.0, 0.1)


FLOOR_M = 0.8
LINE = np.column_stack([np.arange(0.0, 202.0, 2.0), np.zeros(101)])
ROUND = 2 * np.pi * np.arange(0, 160) / 80
TWICE_ROUND = 30 * np.column_stack([np.cos(ROUND), np.sin(ROUND)])  # 2 × 188 m


def ground_m(plan: NDArray[np.float64], bumpy_m: float = 0.1) -> NDArray[np.float64]:
    """A slope with bumps of some metres."""
    x, y = plan.T
    return 0.08 * x - 0.05 * y + bumpy_m * np.sin(1.1 * x + 0.3) * np.cos(0.9 * y)


def seen_from(place_m, seed: int, off_m: float = 0.0, noise_m: float = 0.02, movers: int = 0) -> Look:
    """The ground within 10 m, by a pose that is `off_m` too high; `movers` points stand 1 m above it."""
    rng = np.random.default_rng(seed)
    plan = place_m + rng.uniform(-10.0, 10.0, (6000, 2))
    heights = ground_m(plan) + rng.normal(0.0, noise_m, len(plan))
    heights[:movers] += 1.0
    return look(np.column_stack([plan, heights + off_m]))


def drift_of(looks: list[Look], way: Way, floor_m: float):
    return drift(links_between(looks, way), way, floor_m)


def way_of(places_m) -> Way:
    return Way(places_m, driven(places_m), np.zeros(len(places_m), np.int64))


def looks_of(places_m, off_m, **facts) -> list[Look]:
    return [seen_from(place, row, off, **facts) for row, (place, off) in enumerate(zip(places_m, off_m, strict=True))]


@pytest.mark.parametrize("rate", [-0.01, 0.03])
def test_drift_of_a_straight_way_is_taken_back_to_a_few_centimetres_in_200_m(rate):
    off_m = rate * driven(LINE)
    found, up_m = drift_of(looks_of(LINE, off_m), way_of(LINE), FLOOR_M)
    assert found.is_beyond_terrain
    assert found.is_followable
    assert np.abs(up_m + off_m).max() < 0.05
    assert found.span_m == pytest.approx(abs(rate) * 200.0, abs=0.05)
    assert found.driven_m == pytest.approx(200.0)


def test_rough_and_sloping_ground_without_drift_is_no_drift():
    found, up_m = drift_of(looks_of(LINE, np.zeros(len(LINE))), way_of(LINE), FLOOR_M)
    assert not found.is_beyond_terrain
    assert found.apart_m < TOLERATED_M / 4
    assert np.abs(up_m).max() < 0.05


def test_a_third_of_what_is_seen_may_move_and_looks_may_scatter():
    off_m = 0.01 * driven(LINE)
    _, up_m = drift_of(looks_of(LINE, off_m, noise_m=0.05, movers=2000), way_of(LINE), FLOOR_M)
    assert np.abs(up_m + off_m).max() < 0.1


def test_a_second_visit_at_another_height_lies_on_the_first():
    """Drift that no two looks right after another show: 0.2 %, but 0.4 m after a round."""
    off_m = 0.002 * driven(TWICE_ROUND)
    found, up_m = drift_of(looks_of(TWICE_ROUND, off_m), way_of(TWICE_ROUND), FLOOR_M)
    assert found.apart_m > 0.3
    assert found.is_followable
    twice_m = (off_m + up_m).reshape(2, 80)
    assert np.abs(twice_m[1] - twice_m[0]).max() < 0.03


def test_what_lies_a_floor_higher_is_not_pulled_down():
    """The second round is 3 m above the first, and nothing was seen on the way up: nothing is wrong with the poses."""
    rows = np.concatenate([np.arange(60), np.arange(100, 160)])
    floor_m = np.where(rows < 80, 0.0, 3.0)
    way = Way(TWICE_ROUND[rows], driven(TWICE_ROUND)[rows], np.zeros(len(rows), np.int64))
    found, up_m = drift_of(looks_of(TWICE_ROUND[rows], floor_m), way, FLOOR_M)
    assert not found.is_beyond_terrain
    assert np.abs(up_m).max() < 0.05


def test_maps_are_not_related_to_each_other():
    off_m = np.where(np.arange(160) < 80, 0.0, 2.0)
    maps = (np.arange(160) >= 80).astype(np.int64)
    found, up_m = drift_of(looks_of(TWICE_ROUND, off_m), replace(way_of(TWICE_ROUND), maps=maps), FLOOR_M)
    assert not found.is_beyond_terrain
    assert np.abs(up_m).max() < 0.05


def test_a_step_is_said_to_be_none_that_is_slow():
    off_m = np.where(np.arange(len(LINE)) < 50, 0.0, 1.5)
    found, _ = drift_of(looks_of(LINE, off_m), way_of(LINE), FLOOR_M)
    assert found.is_beyond_terrain
    assert not found.is_followable


@settings(max_examples=10, deadline=None)
@given(st.floats(-50.0, 50.0), st.integers(0, 1000))
def test_the_height_of_the_map_is_nobodys_drift(level_m, seed):
    off_m = 0.01 * driven(LINE[:12]) + level_m
    _, up_m = drift_of([seen_from(p, seed + k, off_m[k]) for k, p in enumerate(LINE[:12])], way_of(LINE[:12]), FLOOR_M)
    assert up_m[0] == pytest.approx(0.0, abs=1e-3)
    assert np.abs(up_m + off_m - off_m[0]).max() < 0.03


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.full((50, 3), 1e12), np.zeros((FEWEST_CELLS - 1, 3))])
def test_where_nothing_can_be_compared_nothing_is_corrected(points):
    found, up_m = drift_of([look(points)] * 6, way_of(LINE[:6]), FLOOR_M)
    assert (found.links, found.apart_m, found.span_m) == (0, 0.0, 0.0)
    assert up_m.tolist() == [0.0] * 6


def test_a_look_has_the_cells_of_the_lattice_and_nothing_that_is_off_it():
    rng = np.random.default_rng(4)
    points = np.column_stack([rng.uniform(-3.0, 3.0, (900, 2)), rng.normal(size=900)])
    cells, lowest = low_points(points, keys_of(points * (1.0, 1.0, 0.0), 0.5))
    for off in ([1e12, 0.0, 0.0], [0.0, -np.inf, 0.0], [np.nan, 0.0, 0.0], [0.0, 0.0, np.nan]):
        found = look(np.insert(points, 400, off, axis=0))
        assert found.cells.tolist() == cells.tolist()
        assert found.heights_m.tolist() == lowest[:, 2].astype(np.float32).tolist()


def test_looks_are_taken_by_the_way_and_not_by_the_frame():
    standing = np.concatenate([np.zeros((500, 2)), LINE])
    assert len(looks_along(standing)) == len(LINE)
    far = np.column_stack([np.arange(0.0, 20_000.0), np.zeros(20_000)])
    assert len(looks_along(far)) == pytest.approx(20_000 / WIDEST_SPACING_M, rel=0.02)
    assert len(looks_along(far[: int(MANY_LOOKS * 2.5)])) == pytest.approx(MANY_LOOKS, rel=0.3)
    assert looks_along(np.zeros((3, 2))).tolist() == [0]
