"""Eq. 1–3 in worlds whose answer is known in closed form."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stone.geometry.se3 import SE3
from stone.surface.mesh import Mesh, vertex_normals
from stone.surface.terrain import ELEVATION, ROUGHNESS, SLOPE, TerrainParameters, roughness, terrain_features

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


def test_twice_the_noise_is_log_four_rougher():
    def noisy(scale):
        return sheet(lambda x, y: scale * np.random.default_rng(5).normal(0, 0.005, x.shape))

    fine, coarse = (np.median(features_of(noisy(scale))[:, ROUGHNESS]) for scale in (1.0, 2.0))
    assert coarse - fine == pytest.approx(math.log(4), abs=0.1)  # not exact: the neighbours are chosen in 3D


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
