"""Low points of cells beside a slow oracle that sorts."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stone.sensors.ground_points import FEWEST_IN_CELL, LOW_QUANTILE, around_robot, low_points


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
