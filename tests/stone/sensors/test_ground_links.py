"""Drift in z is found by the ground alone: to centimetres, on rough ground, over a return, and not between floors."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from stone.geometry.lattice import keys_of
from stone.sensors.ground_links import (
    FEWEST_CELLS,
    MANY_LOOKS,
    WIDEST_SPACING_M,
    Look,
    Way,
    drift,
    driven,
    look,
    looks_along,
)
from stone.sensors.ground_points import low_points
from stone.sensors.height_drift import TOLERATED_M

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


def way_of(places_m) -> Way:
    return Way(places_m, driven(places_m), np.zeros(len(places_m), np.int64))


def looks_of(places_m, off_m, **facts) -> list[Look]:
    return [seen_from(place, row, off, **facts) for row, (place, off) in enumerate(zip(places_m, off_m, strict=True))]


@pytest.mark.parametrize("rate", [0.01, -0.01, 0.03])
def test_drift_of_a_straight_way_is_taken_back_to_a_few_centimetres_in_200_m(rate):
    off_m = rate * driven(LINE)
    found, up_m = drift(looks_of(LINE, off_m), way_of(LINE), FLOOR_M)
    assert found.is_beyond_terrain
    assert found.is_followable
    assert np.abs(up_m + off_m).max() < 0.05
    assert found.span_m == pytest.approx(abs(rate) * 200.0, abs=0.05)
    assert found.driven_m == pytest.approx(200.0)


def test_rough_and_sloping_ground_without_drift_is_no_drift():
    found, up_m = drift(looks_of(LINE, np.zeros(len(LINE))), way_of(LINE), FLOOR_M)
    assert not found.is_beyond_terrain
    assert found.apart_m < TOLERATED_M / 4
    assert np.abs(up_m).max() < 0.05


def test_a_third_of_what_is_seen_may_move_and_looks_may_scatter():
    off_m = 0.01 * driven(LINE)
    _, up_m = drift(looks_of(LINE, off_m, noise_m=0.05, movers=2000), way_of(LINE), FLOOR_M)
    assert np.abs(up_m + off_m).max() < 0.1


def test_a_second_visit_at_another_height_lies_on_the_first():
    """Drift that no two looks right after another show: 0.2 %, but 0.4 m after a round."""
    off_m = 0.002 * driven(TWICE_ROUND)
    found, up_m = drift(looks_of(TWICE_ROUND, off_m), way_of(TWICE_ROUND), FLOOR_M)
    assert found.apart_m > 0.3
    assert found.is_followable
    twice_m = (off_m + up_m).reshape(2, 80)
    assert np.abs(twice_m[1] - twice_m[0]).max() < 0.03


def test_what_lies_a_floor_higher_is_not_pulled_down():
    """The second round is 3 m above the first, and nothing was seen on the way up: nothing is wrong with the poses."""
    rows = np.concatenate([np.arange(60), np.arange(100, 160)])
    floor_m = np.where(rows < 80, 0.0, 3.0)
    way = Way(TWICE_ROUND[rows], driven(TWICE_ROUND)[rows], np.zeros(len(rows), np.int64))
    found, up_m = drift(looks_of(TWICE_ROUND[rows], floor_m), way, FLOOR_M)
    assert not found.is_beyond_terrain
    assert np.abs(up_m).max() < 0.05


def test_maps_are_not_related_to_each_other():
    off_m = np.where(np.arange(160) < 80, 0.0, 2.0)
    maps = (np.arange(160) >= 80).astype(np.int64)
    found, up_m = drift(looks_of(TWICE_ROUND, off_m), replace(way_of(TWICE_ROUND), maps=maps), FLOOR_M)
    assert not found.is_beyond_terrain
    assert np.abs(up_m).max() < 0.05


def test_a_step_is_said_to_be_none_that_is_slow():
    off_m = np.where(np.arange(len(LINE)) < 50, 0.0, 1.5)
    found, _ = drift(looks_of(LINE, off_m), way_of(LINE), FLOOR_M)
    assert found.is_beyond_terrain
    assert not found.is_followable


@settings(max_examples=10, deadline=None)
@given(st.floats(-50.0, 50.0), st.integers(0, 1000))
def test_the_height_of_the_map_is_nobodys_drift(level_m, seed):
    off_m = 0.01 * driven(LINE[:12]) + level_m
    _, up_m = drift([seen_from(p, seed + k, off_m[k]) for k, p in enumerate(LINE[:12])], way_of(LINE[:12]), FLOOR_M)
    assert up_m[0] == pytest.approx(0.0, abs=1e-3)
    assert np.abs(up_m + off_m - off_m[0]).max() < 0.03


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.full((50, 3), 1e12), np.zeros((FEWEST_CELLS - 1, 3))])
def test_where_nothing_can_be_compared_nothing_is_corrected(points):
    found, up_m = drift([look(points)] * 6, way_of(LINE[:6]), FLOOR_M)
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
