"""Marching cubes over every case, and over fields without any order."""

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stone.geometry.lattice import indices_of, keys_from_indices
from stone.surface.band import band_of
from stone.surface.contour import CORNERS, EDGES, TRIANGLES, zero_surface

BLOCK = keys_from_indices(np.stack(np.meshgrid(*[np.arange(4)] * 3, indexing="ij"), axis=-1).reshape(-1, 3))


def directed(triangles):
    """How often each directed edge occurs."""
    edges = np.concatenate([triangles[:, [u, v]] for u, v in ((0, 1), (1, 2), (2, 0))])
    return Counter(map(tuple, edges.tolist()))


@pytest.mark.parametrize("case", range(1 << CORNERS))
def test_each_case_uses_just_the_edges_that_are_crossed(case):
    crossed = {n for n, (base, axis) in enumerate(EDGES) if (case >> base ^ case >> (base | 4 >> axis)) & 1}
    used = TRIANGLES[case][TRIANGLES[case][:, 0] >= 0]
    assert set(used.ravel().tolist()) == crossed


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32))
def test_any_field_has_a_closed_surface(seed):
    """The border is made inside, so that nothing is cut."""
    band = band_of(BLOCK, 0.2)
    field = np.random.default_rng(seed).normal(size=len(band))
    index = indices_of(band.keys)
    field[((index == index.min(axis=0)) | (index == index.max(axis=0))).any(axis=1)] = -1.0
    mesh = zero_surface(band, field)
    edges = directed(mesh.triangles)
    assert edges
    assert edges == {(b, a): count for (a, b), count in edges.items()}


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**32))
def test_a_vertex_is_where_the_field_is_zero_between_two_corners(seed):
    band = band_of(BLOCK, 0.2)
    values = np.random.default_rng(seed).normal(size=len(band))
    value_at = dict(zip(map(tuple, indices_of(band.keys).tolist()), values.tolist(), strict=True))
    for vertex in zero_surface(band, values).vertices_map / 0.2 - 0.5:
        axis = int(np.argmax(np.abs(vertex - np.round(vertex))))
        low, high = np.round(vertex).astype(int), np.round(vertex).astype(int)
        low[axis], high[axis] = np.floor(vertex[axis]), np.floor(vertex[axis]) + 1
        share = vertex[axis] - low[axis]
        between = (1 - share) * value_at[tuple(low.tolist())] + share * value_at[tuple(high.tolist())]
        assert between == pytest.approx(0, abs=1e-9)


def test_a_field_of_one_sign_has_no_surface():
    band = band_of(BLOCK, 0.2)
    for sign in (-1.0, 1.0):
        mesh = zero_surface(band, np.full(len(band), sign))
        assert mesh.vertices_map.shape == mesh.triangles.shape == (0, 3)


def test_triangles_face_the_positive_side():
    band = band_of(BLOCK, 0.2)
    mesh = zero_surface(band, band.places_map() @ [0.2, -0.3, 0.9] - 0.31)
    a, b, c = (mesh.vertices_map[mesh.triangles[:, corner]] for corner in range(3))
    assert (np.cross(b - a, c - a) @ [0.2, -0.3, 0.9] > 0).all()
