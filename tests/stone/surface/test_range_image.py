"""Range images in scenes whose returns are known, pixel by pixel."""

import math
from itertools import pairwise

import numpy as np
import pytest

from stone.geometry.se3 import SE3
from stone.surface.range_image import (
    MAX_RING_GAP_PX,
    MAX_SPREAD_PX,
    DynamicParameters,
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
