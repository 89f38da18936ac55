"""Plane fits and nearness by brute force, vertex normals by a loop, Eq. 1–3 in worlds known in closed form."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit

from stone.geometry.se3 import SE3
from stone.surface.mesh import Mesh, vertex_normals
from stone.surface.neighbours import FEWEST, cells_of, eigenvector, is_near, plane_fits, smallest_eigenvalue
from stone.surface.terrain import ELEVATION, ROUGHNESS, SLOPE, TerrainParameters, roughness, terrain_features
from testing.refusals import refused_as

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


@pytest.mark.whole
@settings(max_examples=80, deadline=None)
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
    with refused_as("off_lattice"):
        is_near(np.full((1, 3), np.nan), np.zeros((1, 3)), 1.0)


def fan(rng, spokes=7):
    """A bumpy disk around vertex 0."""
    angle = np.linspace(0, 2 * np.pi, spokes, endpoint=False)
    rim = np.column_stack([np.cos(angle), np.sin(angle), rng.normal(0, 0.3, spokes)])
    triangles = [[0, 1 + i, 1 + (i + 1) % spokes] for i in range(spokes)]
    return Mesh(np.concatenate([np.zeros((1, 3)), rim]), np.array(triangles, np.int32))


def normals_slowly(mesh):
    sums = np.zeros_like(mesh.vertices_map)
    for face in mesh.triangles:
        a, b, c = mesh.vertices_map[face]
        normal = np.cross(b - a, c - a)
        for vertex in face:
            sums[vertex] += normal / np.linalg.norm(normal)
    return sums / np.linalg.norm(sums, axis=1, keepdims=True)


def test_a_normal_is_the_mean_of_the_faces_around():
    mesh = fan(np.random.default_rng(1))
    np.testing.assert_allclose(vertex_normals(mesh), normals_slowly(mesh), atol=1e-14)


def test_counter_clockwise_is_up_and_clockwise_down():
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    assert (vertex_normals(Mesh(corners, np.array([[0, 1, 2]], np.int32))) == [0, 0, 1]).all()
    assert (vertex_normals(Mesh(corners, np.array([[0, 2, 1]], np.int32))) == [0, 0, -1]).all()


def test_degenerate_faces_and_lonely_vertices_count_for_nothing():
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0], [9, 9, 9]])
    normals = vertex_normals(Mesh(corners, np.array([[0, 1, 2], [0, 1, 3]], np.int32)))
    assert normals.tolist() == [[0, 0, 1], [0, 0, 1], [0, 0, 1], [0, 0, 0], [0, 0, 0]]


def test_a_kept_triangle_keeps_its_corners():
    mesh = fan(np.random.default_rng(2))
    keep = np.ones(8, np.bool_)
    keep[3] = False
    kept = mesh.where(keep)
    whole = [face for face in mesh.triangles if 3 not in face]
    assert len(kept.triangles) == len(whole) == 5
    np.testing.assert_array_equal(kept.vertices_map[kept.triangles], mesh.vertices_map[np.array(whole)])


def test_a_mesh_may_lose_everything():
    nothing = fan(np.random.default_rng(3)).where(np.zeros(8, np.bool_))
    assert nothing.vertices_map.shape == nothing.triangles.shape == (0, 3)
    assert nothing.where(np.zeros(0, np.bool_)).triangles.shape == (0, 3)


PARAMETERS = TerrainParameters()
# Rows of a `sheet` that are 0.3 m off its rim: there all 20 neighbours are within two cells, so the search is exact.
INNER = (np.arange(21)[3:18, None] * 21 + np.arange(21)[3:18]).ravel()


def sheet(height, side=21, step_m=0.1):
    """A grid of vertices at `height(x, y)`, triangulated counter-clockwise from above."""
    x, y = (axis.ravel() * step_m for axis in np.meshgrid(np.arange(side), np.arange(side), indexing="ij"))
    a = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
    triangles = np.concatenate([np.stack([a, a + side, a + 1], 1), np.stack([a + side, a + side + 1, a + 1], 1)])
    return Mesh(np.stack([x, y, height(x, y)], axis=1), triangles.astype(np.int32))


def features_of(mesh):
    return terrain_features(mesh, vertex_normals(mesh), PARAMETERS)


def moved(mesh, map_from_map):
    return Mesh(map_from_map @ mesh.vertices_map, mesh.triangles)


def bumpy(seed):
    return sheet(lambda x, y: np.random.default_rng(seed).normal(0, 0.05, x.shape) + 0.3 * x)


@settings(max_examples=25, deadline=None)
@given(st.floats(-2, 2), st.floats(-2, 2))
def test_a_tilted_plane_has_exactly_its_slope(a, b):
    features = features_of(sheet(lambda x, y: a * x + b * y + 1))
    np.testing.assert_allclose(features[:, SLOPE], math.atan(math.hypot(a, b)), atol=1e-7)
    np.testing.assert_allclose(features[:, ROUGHNESS], math.log(PARAMETERS.roughness_floor_m2), atol=1e-9)


def test_elevation_is_z():
    mesh = bumpy(1)
    assert (features_of(mesh)[:, ELEVATION] == mesh.vertices_map[:, 2]).all()


def test_an_underside_is_steeper_than_a_wall():
    mesh = sheet(lambda x, y: 0.2 * x)
    below = Mesh(mesh.vertices_map, mesh.triangles[:, ::-1])
    np.testing.assert_allclose(features_of(below)[:, SLOPE], math.pi - math.atan(0.2), atol=1e-7)


def test_roughness_is_the_log_of_the_variance_about_the_plane():
    sigma_m, many = 0.02, TerrainParameters(neighbours=200, cell_m=0.8)
    mesh = sheet(lambda x, y: np.random.default_rng(4).normal(0, sigma_m, x.shape) + 0.1 * y, side=41)
    inner = (np.abs(mesh.vertices_map[:, :2] - 2) < 1).all(axis=1)
    # three parameters of the plane cost 3 of 200 squares, the tilt 1 % of the distance; 10 % for chance
    assert np.exp(roughness(mesh.vertices_map, many)[inner]).mean() == pytest.approx(sigma_m**2, rel=0.1)


def test_a_vertex_with_too_few_neighbours_is_as_smooth_as_can_be_told():
    lonely = roughness(np.array([[0.0, 0, 0], [9, 9, 9]]), PARAMETERS)
    assert lonely.tolist() == [math.log(PARAMETERS.roughness_floor_m2)] * 2


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 2**32), *[st.floats(-300, 300)] * 3)
def test_moving_the_world_moves_nothing_but_elevation(seed, x, y, z):
    mesh = bumpy(seed)
    there = features_of(moved(mesh, SE3(np.array([1.0, 0, 0, 0, x, y, z]))))
    here = features_of(mesh)
    np.testing.assert_allclose(there[:, ELEVATION], here[:, ELEVATION] + z, atol=1e-9)
    np.testing.assert_allclose(there[INNER, 1:], here[INNER, 1:], atol=1e-6)


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 2**32), st.floats(-math.pi, math.pi))
def test_yawing_the_world_changes_nothing(seed, yaw):
    mesh = bumpy(seed)
    turned = moved(mesh, SE3(np.array([math.cos(yaw / 2), 0, 0, math.sin(yaw / 2), 0, 0, 0])))
    np.testing.assert_allclose(features_of(turned)[INNER], features_of(mesh)[INNER], atol=1e-6)
