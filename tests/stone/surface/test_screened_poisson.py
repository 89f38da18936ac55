"""The screened Poisson field and its surface: least squares written out, closed forms, and marching cubes."""

from collections import Counter
from itertools import product

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from stone.geometry.lattice import centres_of, indices_of, keys_from_indices, keys_of
from stone.surface.contour import ABOVE, BELOW, CORNERS, EDGES, TRIANGLES, band_of, zero_surface
from stone.surface.mesh import vertex_normals
from stone.surface.neighbours import is_near
from stone.surface.patches import patches_of
from stone.surface.screened_poisson import FULL_POINTS, MOST_ROUNDS, PoissonParameters, blurred_planes, solve_field

W = 0.2
EXACT = PoissonParameters(tolerance_ratio=1e-10)
SEEDS = st.integers(0, 2**32)


def bumpy(seed, size_m=1.2, spacing_m=0.07):
    """Points on a rolling sheet and the direction they were seen from."""
    rng = np.random.default_rng(seed)
    line = np.arange(0, size_m, spacing_m)
    xy = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2) + rng.uniform(-0.02, 0.02, (len(line) ** 2, 2))
    z = 0.15 * np.sin(3 * xy[:, 0]) + 0.1 * xy[:, 1] + rng.normal(0, 0.005, len(xy))
    return np.column_stack([xy, z]) + np.array([-0.7, 5.3, 0.31]), np.tile([0.0, 0.1, 0.9], (len(xy), 1))


def sphere(radius_m=1.5, count=9000, seed=0):
    outward = np.random.default_rng(seed).normal(size=(count, 3))
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    return radius_m * outward, outward


def surface(points, views, parameters=EXACT):
    patches, _ = patches_of(points, views, W, 20)
    band = band_of(patches.cells, W)
    return zero_surface(band, solve_field(patches, band, parameters).values)


def slow_planes(patches, places, sigma_m):
    """Corner by corner, patch by patch."""
    offset = [int(o) for o in (-BELOW, ABOVE)]
    for place in places:
        sums, total = np.zeros(4), 0.0
        for key, point, normal, count in zip(
            patches.cells, patches.points_map, patches.normals, patches.counts, strict=True
        ):
            index = np.round(place / W - 0.5).astype(int) - indices_of(np.array([key]))[0]
            if (index >= offset[0]).all() and (index <= offset[1]).all():
                weight = count * np.exp(-((place - point) ** 2).sum() / (2 * sigma_m**2))
                sums += weight * np.append(normal, (place - point) @ normal)
                total += weight
        yield sums / total


def slow_field(patches, band, parameters):
    """The minimum of the energy as one dense least-squares problem, a row per edge and per patch."""
    places = band.places_map()
    normals = np.array(list(slow_planes(patches, places, parameters.blur_ratio * W)))[:, :3]
    row_of = {tuple(index): row for row, index in enumerate(indices_of(band.keys).tolist())}
    rows, right = [], []
    for index, a in row_of.items():
        for axis in range(3):
            b = row_of.get(tuple(np.array(index) + np.eye(3, dtype=int)[axis]))
            if b is not None:
                rows.append(np.zeros(len(band)))
                rows[-1][[a, b]] = -1, 1
                right.append(W * (normals[a, axis] + normals[b, axis]) / 2)
    for key, point, count in zip(patches.cells, patches.points_map, patches.counts, strict=True):
        least = indices_of(np.array([key]))[0]
        far = point / W - 0.5 - least
        pull = np.sqrt(parameters.screening * min(count, FULL_POINTS) / FULL_POINTS)
        rows.append(np.zeros(len(band)))
        right.append(0.0)
        for corner in product((0, 1), repeat=3):
            share = np.prod([f if side else 1 - f for f, side in zip(far, corner, strict=True)])
            rows[-1][row_of[tuple(least + corner)]] = pull * share
    matrix = np.array(rows)
    return np.linalg.solve(matrix.T @ matrix, matrix.T @ right)


@settings(max_examples=2, deadline=None)
@given(SEEDS, st.sampled_from([0.5, 8.0]))
def test_the_field_is_the_minimum_of_the_energy_written_out_as_least_squares(seed, screening):
    patches, _ = patches_of(*bumpy(seed, size_m=0.3), W, 12)
    band = band_of(patches.cells, W)
    parameters = PoissonParameters(screening, tolerance_ratio=1e-10)
    found = solve_field(patches, band, parameters).values
    np.testing.assert_allclose(found, slow_field(patches, band, parameters), atol=1e-8)


def test_planes_are_blurred_as_corner_by_corner():
    patches, _ = patches_of(*bumpy(3, size_m=0.5), W, 12)
    band = band_of(patches.cells, W)
    slow = list(slow_planes(patches, band.places_map(), 0.15))
    np.testing.assert_allclose(blurred_planes(patches, band, 0.15), slow, atol=1e-12)


@settings(max_examples=10, deadline=None)
@given(SEEDS)
def test_the_band_is_every_corner_of_the_cells_around_the_data(seed):
    index = np.unique(np.random.default_rng(seed).integers(-6, 6, (20, 3)), axis=0)
    band = band_of(keys_from_indices(index), W)
    around = {tuple(i + d) for i in index for d in product(range(-BELOW, ABOVE + 1), repeat=3)}
    assert {tuple(i) for i in indices_of(band.keys)} == around
    assert (np.diff(band.keys) > 0).all()
    assert (band.places_map() == centres_of(band.keys, W)).all()
    corners = index[:, None] + list(product((0, 1), repeat=3))
    assert (indices_of(band.keys)[band.corners] == corners).all()
    for axis, step in enumerate(np.eye(3, dtype=int)):
        has_next = band.onward[:, axis] >= 0
        np.testing.assert_array_equal(has_next, [tuple(i + step) in around for i in indices_of(band.keys)])
        onward = band.onward[has_next, axis]
        assert (indices_of(band.keys)[onward] == indices_of(band.keys)[has_next] + step).all()


@given(st.floats(-1, 1), st.floats(-1, 1), st.floats(-5, 5))
@example(0.0, 1.0, 0.0)  # through the corners of the lattice: slivers, whose directions are those of rounding
@example(0.5, 0.5, 0.0)
@settings(max_examples=10, deadline=None)
def test_a_plane_is_found_exactly_and_faces_those_who_saw_it(a, b, c):
    rng = np.random.default_rng(1)
    xy = rng.uniform(-1, 1, (900, 2))
    points = np.column_stack([xy, xy @ [a, b] + c])
    up = np.array([-a, -b, 1]) / np.sqrt(a * a + b * b + 1)
    mesh = surface(points, np.tile(up, (900, 1)))
    assert len(mesh.triangles) > 100
    np.testing.assert_allclose((mesh.vertices_map - [0, 0, c]) @ up, 0, atol=1e-7)
    with_area = np.linalg.norm(vertex_normals(mesh), axis=1) > 0
    np.testing.assert_allclose(vertex_normals(mesh)[with_area] @ up, 1, atol=1e-6)


def test_a_sphere_is_one_closed_surface_of_its_radius():
    mesh = surface(*sphere())
    np.testing.assert_allclose(np.linalg.norm(mesh.vertices_map, axis=1), 1.5, atol=0.012)
    edges = np.concatenate([mesh.triangles[:, [u, v]] for u, v in ((0, 1), (1, 2), (2, 0))])
    ahead, back = ({tuple(edge) for edge in pairs.tolist()} for pairs in (edges, edges[:, ::-1]))
    assert ahead == back  # every edge twice, once in each direction
    assert len(ahead) == len(edges)
    assert len(mesh.vertices_map) - len(edges) // 2 + len(mesh.triangles) == 2
    outward = np.einsum("vi,vi->v", vertex_normals(mesh), mesh.vertices_map) / 1.5
    assert outward.min() > 0.99


def test_what_lies_farther_away_changes_no_voxel():
    """The half of a sheet is the same whether its other half, from 1.5 m away on, was ever seen."""
    points, views = bumpy(5, size_m=6.0)
    near = points[:, 0] < 2.3 + 1.6 - 0.1
    whole, part = surface(points, views), surface(points[near], views[near])
    a, b = (mesh.vertices_map[mesh.vertices_map[:, 0] < 2.3] for mesh in (whole, part))
    assert len(a) == len(b) > 500
    assert is_near(a, b, 5e-4).all()
    assert (np.unique(keys_of(a, W)) == np.unique(keys_of(b, W))).all()


def test_moving_the_points_by_whole_cells_moves_the_surface():
    (points, views), shift_m = bumpy(6), np.array([40, -25, 3]) * W
    a, b = surface(points, views), surface(points + shift_m, views)
    np.testing.assert_allclose(a.vertices_map + shift_m, b.vertices_map, atol=1e-6)
    assert (a.triangles == b.triangles).all()


@pytest.mark.parametrize("count", [0, 3])
def test_points_without_a_plane_make_no_patch(count):
    patches, is_in_patch = patches_of(np.ones((count, 3)), np.ones((count, 3)), W, 20)
    assert len(patches) == 0
    assert not is_in_patch.any()


def test_patches_are_the_means_of_their_cells():
    points, views = bumpy(8)
    patches, is_in_patch = patches_of(points, views, W, 20)
    cells = np.floor(points / W - 0.5).astype(int)
    assert is_in_patch.all()
    assert patches.counts.sum() == len(points)
    for key, mean, normal, count in zip(
        patches.cells, patches.points_map, patches.normals, patches.counts, strict=True
    ):
        mine = (cells == indices_of(np.array([key]))[0]).all(axis=1)
        assert mine.sum() == count
        np.testing.assert_allclose(mean, points[mine].mean(axis=0), atol=1e-12)
        nearest = np.argsort(np.linalg.norm(points - mean, axis=1))[:20]
        plane = np.linalg.eigh(np.cov(points[nearest].T))[1][:, 0]
        assert abs(plane @ normal) == pytest.approx(1, abs=1e-6)
        assert normal @ [0.0, 0.1, 0.9] > 0


@pytest.mark.parametrize("tolerance_ratio", [1e-3, 1e-5, 1e-10])
def test_a_field_that_was_solved_for_says_how_well(tolerance_ratio):
    patches, _ = patches_of(*bumpy(1), W, 20)
    descent = solve_field(
        patches, band_of(patches.cells, W), PoissonParameters(tolerance_ratio=tolerance_ratio)
    ).descent
    assert 0 < descent.rounds < 200
    assert 0 < descent.residual_ratio <= 1.001 * tolerance_ratio


def test_a_field_that_was_not_solved_for_says_so():
    """What is asked for is less than numbers hold: no number of rounds is enough, whatever they carry along."""
    patches, _ = patches_of(*bumpy(1), W, 20)
    descent = solve_field(patches, band_of(patches.cells, W), PoissonParameters(tolerance_ratio=1e-300)).descent
    assert 200 < descent.rounds <= MOST_ROUNDS
    assert 1e-18 < descent.residual_ratio < 1e-9


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
