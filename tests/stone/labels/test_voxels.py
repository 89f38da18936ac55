"""Eq. 4–5 against a dict, and heights above the ground nearby on a hill with a post."""

import math
from collections import defaultdict

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from stone.geometry.lattice import centres_of, indices_of, keys_from_indices
from stone.labels.voxels import VOXEL_M, VoxelFeatures, height_above_local_ground, voxel_features

SEEDS = st.integers(0, 2**32)


def scattered(seed, count=300):
    rng = np.random.default_rng(seed)
    return rng.uniform(-1, 1, (count, 3)) + np.array([40, -7, 300]), rng.normal(0, 5, (count, 3))


@settings(max_examples=20, deadline=None)
@given(SEEDS)
def test_a_voxel_has_the_mean_features_of_its_vertices(seed):
    vertices, features = scattered(seed)
    inside = defaultdict(list)
    for vertex, row in zip(vertices, features, strict=True):
        inside[tuple(math.floor(c / VOXEL_M) for c in vertex)].append(row)
    made = voxel_features(vertices, features)
    assert [tuple(row) for row in indices_of(made.keys).tolist()] == sorted(inside)
    np.testing.assert_allclose(made.features, [np.mean(inside[v], axis=0) for v in sorted(inside)], atol=1e-12)


@settings(max_examples=20, deadline=None)
@given(SEEDS)
def test_the_order_of_vertices_does_not_matter(seed):
    vertices, features = scattered(seed)
    order = np.random.default_rng(seed).permutation(len(vertices))
    made, shuffled = voxel_features(vertices, features), voxel_features(vertices[order], features[order])
    assert (made.keys == shuffled.keys).all()
    np.testing.assert_allclose(made.features, shuffled.features, atol=1e-12)


def test_no_vertices_make_no_voxels():
    made = voxel_features(np.zeros((0, 3)), np.zeros((0, 3)))
    assert len(made) == 0
    assert made.features.shape == (0, 3)
    assert height_above_local_ground(made, 0.5).shape == (0,)


def hill_with_a_post(grade=0.5, post_m=2.0):
    """(voxels, which are of the post): a slope along x, 12 m long, with a post on it."""
    plan = np.stack(np.meshgrid(np.arange(-30, 30), np.arange(-30, 30), indexing="ij"), axis=-1).reshape(-1, 2)
    ground = np.floor((plan[:, 0] + 0.5) * grade).astype(np.int64)
    post = np.stack([np.full(10, 5), np.full(10, 5), np.arange(10) + 3], axis=1)
    keys = np.sort(keys_from_indices(np.concatenate([np.column_stack([plan, ground]), post])))
    is_post = np.isin(keys, keys_from_indices(post))
    features = np.zeros((len(keys), 3))
    features[:, 0] = centres_of(keys, VOXEL_M)[:, 2]
    return VoxelFeatures(keys, features), is_post


def heights_slowly(voxels, reach):
    """Minimum over the window of columns, then the mean of that over the window, by loops."""
    lowest = {}
    for (i, j, _), (z, _, _) in zip(indices_of(voxels.keys).tolist(), voxels.features, strict=True):
        lowest[i, j] = min(z, lowest.get((i, j), math.inf))
    window = [(di, dj) for di in range(-reach, reach + 1) for dj in range(-reach, reach + 1)]

    def least(i, j):
        return min(lowest.get((i + di, j + dj), math.inf) for di, dj in window)

    def floor(i, j):
        around = [least(i + di, j + dj) for di, dj in window]
        return np.mean([z for z in around if z < math.inf])

    columns = indices_of(voxels.keys)[:, :2].tolist()
    return [z - floor(i, j) for (i, j), z in zip(columns, voxels.features[:, 0], strict=True)]


@settings(max_examples=5, deadline=None)
@given(SEEDS)
def test_heights_are_those_of_two_plain_windows(seed):
    rng = np.random.default_rng(seed)
    keys = np.unique(keys_from_indices(rng.integers(-8, 8, (90, 3))))
    voxels = VoxelFeatures(keys, rng.normal(0, 1, (len(keys), 3)))
    np.testing.assert_allclose(height_above_local_ground(voxels, 0.4), heights_slowly(voxels, 2), atol=1e-12)


def test_a_post_stands_out_of_a_hill_and_the_hill_does_not():
    voxels, is_post = hill_with_a_post()
    height_m = height_above_local_ground(voxels, 0.5)
    inner = (np.abs(indices_of(voxels.keys)[:, :2]) < 25).all(axis=1)
    slope_part_m = 0.5 * 0.5 + 2 * VOXEL_M  # the rise of the grade within the window, and steps of whole voxels
    assert np.abs(height_m[inner & ~is_post]).max() <= slope_part_m
    assert np.ptp(voxels.features[~is_post, 0]) > 5.5
    top = centres_of(voxels.keys, VOXEL_M)[is_post, 2].max() - 0.5 * 5.5 * VOXEL_M
    assert height_m[is_post].max() >= top
    assert top > 1.5


@settings(max_examples=10, deadline=None)
@given(st.integers(-1000, 1000))
def test_the_height_of_the_hill_does_not_matter(up):
    voxels, _ = hill_with_a_post()
    raised = VoxelFeatures(
        keys_from_indices(indices_of(voxels.keys) + np.array([0, 0, up])),
        voxels.features + np.array([up * VOXEL_M, 0, 0]),
    )
    np.testing.assert_allclose(
        height_above_local_ground(raised, 0.5), height_above_local_ground(voxels, 0.5), atol=1e-9
    )
