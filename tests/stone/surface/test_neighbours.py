"""Plane fits against brute force and `np.linalg.eigh`; nearness against all pairs."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit

from stone.geometry.lattice import OffLatticeError
from stone.surface.neighbour_search import FEWEST, eigenvector, smallest_eigenvalue
from stone.surface.neighbours import cells_of, is_near, plane_fits

SEEDS = st.integers(0, 2**32)
CELL_M = 0.2


@njit
def smallest(a):
    value = smallest_eigenvalue(a[0, 0], a[0, 1], a[0, 2], a[1, 1], a[1, 2], a[2, 2])
    return value, eigenvector(a[0, 0], a[0, 1], a[0, 2], a[1, 1], a[1, 2], a[2, 2], value)


def fits_slowly(points, k):
    """(mean square, normal or None, eigenvalues) per point, from all pairs: exact where k lie within two cells."""
    for at in points:
        distance = np.linalg.norm(points - at, axis=1)
        nearest = np.argsort(distance, kind="stable")[:k]
        values, vectors = np.linalg.eigh(np.cov(points[nearest].T, bias=True))
        yield distance[nearest[-1]], values, vectors[:, 0]


@settings(max_examples=8, deadline=None)
@given(SEEDS, st.integers(4, 25))
def test_fits_are_those_of_brute_force_wherever_the_neighbours_are_within_two_cells(seed, k):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.6, 0.6, (400, 3)) * [1, 1, 0.4] + [-30, 12, 2]
    fits, exact = plane_fits(cells_of(points, CELL_M), k), 0
    for (reach_m, values, normal), mean_square, fitted in zip(
        fits_slowly(points, k), fits.mean_square_m2, fits.normals, strict=True
    ):
        if reach_m <= 2 * CELL_M:
            exact += 1
            assert mean_square == pytest.approx(max(values[0], 0), abs=1e-11)
            if values[1] - values[0] > 1e-5:
                assert abs(fitted @ normal) == pytest.approx(1, abs=1e-6)
    assert exact > 300


@settings(max_examples=200, deadline=None)
@given(SEEDS, st.floats(-8, 8))
def test_the_closed_form_is_that_of_eigh(seed, exponent):
    root = np.random.default_rng(seed).normal(size=(3, 3))
    matrix = root @ root.T * 10**exponent
    values, vectors = np.linalg.eigh(matrix)
    value, vector = smallest(matrix)
    assert value == pytest.approx(values[0], abs=1e-12 * values[2])
    if values[1] - values[0] > 1e-3 * values[2]:
        assert abs(np.dot(vector, vectors[:, 0])) == pytest.approx(1, abs=1e-6)


def test_equal_eigenvalues_are_found():
    assert smallest(4.0 * np.eye(3))[0] == 4.0
    assert smallest(np.zeros((3, 3)))[0] == 0.0
    assert smallest(np.diag([1.0, 5.0, 5.0]))[0] == pytest.approx(1, abs=1e-14)


def test_points_on_a_plane_fit_it_exactly():
    rng = np.random.default_rng(2)
    plan = rng.uniform(-1, 1, (500, 2))
    points = np.column_stack([plan, 0.3 * plan[:, 0] - 0.2 * plan[:, 1] + 5])
    fits = plane_fits(cells_of(points, CELL_M), 20)
    normal = np.array([-0.3, 0.2, 1]) / np.linalg.norm([-0.3, 0.2, 1])
    assert fits.mean_square_m2.max() < 1e-14
    np.testing.assert_allclose(np.abs(fits.normals @ normal), 1, atol=1e-9)


def test_too_few_neighbours_give_no_plane():
    points = np.array([[0.05 * i, 0.0, 0.0] for i in range(FEWEST - 1)] + [[50.0, 0, 0]])
    fits = plane_fits(cells_of(points, CELL_M), 20)
    assert np.isnan(fits.mean_square_m2).all()
    assert (fits.normals == 0).all()


def test_fits_come_in_the_order_of_the_points():
    rng = np.random.default_rng(3)
    points, order = rng.uniform(-1, 1, (300, 3)), rng.permutation(300)
    fits, shuffled = plane_fits(cells_of(points, CELL_M), 10), plane_fits(cells_of(points[order], CELL_M), 10)
    np.testing.assert_allclose(shuffled.mean_square_m2, fits.mean_square_m2[order], atol=1e-14)


def test_crowded_cells_and_equal_points_are_searched_as_all_are():
    rng = np.random.default_rng(4)
    crowd = np.repeat(rng.uniform(0.01, CELL_M - 0.01, (40, 3)), 50, axis=0)
    points = np.concatenate([crowd, rng.uniform(-CELL_M, 2 * CELL_M, (200, 3))])
    fits = plane_fits(cells_of(points, CELL_M), 120)
    for (_, values, _), mean_square in zip(fits_slowly(points, 120), fits.mean_square_m2, strict=True):
        assert mean_square == pytest.approx(max(values[0], 0), abs=1e-11)


def test_there_is_room_for_all_points_of_all_cells_that_are_searched():
    corners = np.stack(np.meshgrid(*[np.arange(-2, 3)] * 3), axis=-1).reshape(-1, 3) * CELL_M
    points = (corners + np.random.default_rng(5).uniform(0.01, CELL_M - 0.01, (3, 125, 3))).reshape(-1, 3)
    middle = int(np.argmin(np.abs(points - CELL_M / 2).max(axis=1)))
    fits = plane_fits(cells_of(points, CELL_M), 375)
    values = np.linalg.eigvalsh(np.cov(points.T, bias=True))
    assert fits.mean_square_m2[middle] == pytest.approx(values[0], abs=1e-11)


def test_no_points_have_no_fits():
    fits = plane_fits(cells_of(np.zeros((0, 3)), CELL_M), 20)
    assert fits.mean_square_m2.shape == (0,)
    assert fits.normals.shape == (0, 3)


@settings(max_examples=20, deadline=None)
@given(SEEDS, st.floats(0.05, 1.5))
def test_nearness_is_that_of_all_pairs(seed, radius_m):
    rng = np.random.default_rng(seed)
    queries, points = rng.uniform(-2, 2, (150, 3)), rng.uniform(-2, 2, (120, 3))
    square = ((queries[:, None] - points) ** 2).sum(axis=2).min(axis=1)
    assert is_near(queries, points, radius_m).tolist() == (square <= radius_m**2).tolist()


def test_nearness_includes_its_radius():
    assert is_near(np.array([[1.0, 0, 0], [1.0 + 1e-9, 0, 0]]), np.zeros((1, 3)), 1.0).tolist() == [True, False]


def test_nothing_is_near_to_nothing():
    assert not is_near(np.zeros((3, 3)), np.zeros((0, 3)), 1.0).any()
    assert len(is_near(np.zeros((0, 3)), np.zeros((3, 3)), 1.0)) == 0


def test_queries_off_the_lattice_are_refused():
    with pytest.raises(OffLatticeError, match="is a pose broken"):
        is_near(np.full((1, 3), np.nan), np.zeros((1, 3)), 1.0)
