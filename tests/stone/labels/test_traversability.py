"""Eq. 4–5 against a dict; the reference against numpy, scipy and every subset; what alpha and the floor do."""

import math
from collections import defaultdict
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import mahalanobis

from stone.geometry.lattice import centres_of, indices_of, keys_from_indices
from stone.labels.robust_scatter import robust_scatter
from stone.labels.traversability import (
    NON_TRAVERSABLE,
    POTENTIAL,
    TRAVERSABLE,
    ReferenceParameters,
    classify,
    distance_squared,
    reference_of,
    sums_of,
    threshold,
    total_of,
)
from stone.labels.voxels import VOXEL_M, VoxelFeatures, height_above_local_ground, voxel_features
from testing.refusals import refused_as

SEEDS = st.integers(0, 2**32)
PARAMETERS = ReferenceParameters()
ORIGIN = np.array([250.0, 0.0, 0.0])


def driven(seed, count=200):
    """Features of driven ground, far above the datum."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(3, 3)) + 2 * np.eye(3)
    return rng.normal(size=(count, 3)) @ (root * [[0.5], [0.05], [1.0]]) + [251.0, 0.1, -8.0]


def reference(features, parameters=PARAMETERS):
    return reference_of(sums_of(features, ORIGIN), parameters)


@settings(max_examples=30, deadline=None)
@given(SEEDS)
def test_mean_and_covariance_are_those_of_numpy(seed):
    features = driven(seed)
    made = reference(features)
    np.testing.assert_allclose(made.mean, features.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(made.covariance, np.cov(features.T), rtol=1e-9, atol=1e-12)
    assert made.voxels == len(features)
    assert not made.is_floored


@settings(max_examples=30, deadline=None)
@given(SEEDS, st.lists(st.integers(0, 200), max_size=4))
def test_sums_of_parts_add_to_the_sums_of_the_whole(seed, cuts):
    features = driven(seed)
    whole = sums_of(features, ORIGIN)
    total = total_of([sums_of(part, ORIGIN) for part in np.split(features, sorted(cuts))])
    assert total.count == whole.count
    np.testing.assert_allclose(total.total, whole.total, rtol=1e-10, atol=1e-9)
    np.testing.assert_allclose(total.outer, whole.outer, rtol=1e-10, atol=1e-9)


@settings(max_examples=30, deadline=None)
@given(SEEDS)
def test_distance_is_that_of_scipy(seed):
    made, features = reference(driven(seed)), driven(seed + 1, 40)
    inverse = np.linalg.inv(made.covariance)
    expected = [mahalanobis(row, made.mean, inverse) ** 2 for row in features]
    np.testing.assert_allclose(distance_squared(features, made), expected, rtol=1e-9)


def test_the_threshold_is_the_tabled_one():
    assert threshold(0.05) == pytest.approx(7.815, abs=5e-4)


def test_a_share_alpha_of_gaussian_ground_is_beyond_the_threshold():
    features = driven(7, 40_000)
    beyond = distance_squared(features, reference(features)) > threshold(0.05)
    assert beyond.mean() == pytest.approx(0.05, abs=5 * math.sqrt(0.05 * 0.95 / 40_000))


@settings(max_examples=30, deadline=None)
@given(SEEDS, st.floats(1e-4, 0.999), st.floats(1e-4, 0.999))
def test_scaling_alpha_is_monotone(seed, a, b):
    made, features = reference(driven(seed)), driven(seed + 1) * [1, 1, 1.2]
    none = np.zeros(len(features), np.bool_)
    squared = distance_squared(features, made)
    strict, lenient = (classify(squared, none, alpha) == POTENTIAL for alpha in (max(a, b), min(a, b)))
    assert (lenient | ~strict).all()


def test_driven_voxels_are_traversable_whatever_they_look_like():
    made = reference(driven(1))
    features = np.stack([made.mean, made.mean + 100, made.mean, made.mean + 100])
    classes = classify(distance_squared(features, made), np.array([True, True, False, False]), 0.05)
    assert classes.tolist() == [TRAVERSABLE, TRAVERSABLE, POTENTIAL, NON_TRAVERSABLE]
    assert classes.dtype == np.uint8


@pytest.mark.parametrize("count", [0, 3])
def test_too_few_driven_voxels_make_no_reference(count):
    with refused_as("no_reference"):
        reference(driven(1)[:count])


@pytest.mark.parametrize("flat", [[0, 1, 1], [1, 0, 1], [1, 1, 0], [0, 0, 0]])
def test_a_singular_covariance_is_floored_and_said(flat):
    features = (driven(1) - [251.0, 0.1, -8.0]) * flat + [251.0, 0.1, -8.0]
    made = reference(features)
    assert made.is_floored
    np.testing.assert_allclose(made.covariance, np.cov(features.T) + np.diag(np.square(PARAMETERS.floor)), atol=1e-9)
    assert np.isfinite(distance_squared(features, made)).all()


def test_the_local_floor_fades_as_the_track_grows():
    parameters = ReferenceParameters(floor_voxels=200)
    for count in (20, 2_000, 20_000):
        features = driven(3, count)
        made = reference(features, parameters)
        share = 200 / (200 + count)
        expected = np.cov(features.T) + share * np.diag(np.square(parameters.floor))
        np.testing.assert_allclose(made.covariance, expected, rtol=1e-8, atol=1e-9)
        assert made.is_floored


def test_the_origin_does_not_matter():
    features = driven(5)
    a, b = (reference_of(sums_of(features, origin), PARAMETERS) for origin in (ORIGIN, ORIGIN - np.array([3, 1, -2])))
    np.testing.assert_allclose(a.mean, b.mean, rtol=1e-12)
    np.testing.assert_allclose(a.covariance, b.covariance, rtol=1e-8, atol=1e-10)


ROOT = np.array([[0.3, 0.0, 0.0], [0.02, 0.05, 0.0], [0.1, -0.3, 0.8]])
MEAN = np.array([251.0, 0.1, -8.0])


def ground(seed, count):
    return np.random.default_rng(seed).normal(size=(count, 3)) @ ROOT.T + MEAN


def least_determinant(rows, kept):
    """By trying all subsets."""
    return min(np.linalg.det(np.cov(rows[list(subset)].T)) for subset in combinations(range(len(rows)), kept))


@settings(max_examples=20, deadline=None)
@given(SEEDS)
def test_the_best_of_all_subsets_is_the_one_without_what_is_far_and_it_is_found(seed):
    rng = np.random.default_rng(seed)
    rows = np.concatenate([rng.normal(size=(9, 2)), rng.normal(size=(3, 2)) + rng.choice([-9, 9], (3, 2))])
    kept = math.ceil(0.75 * len(rows))
    found = robust_scatter(rows, 0.25)
    assert not found.is_inlier[9:].any()
    assert np.linalg.det(np.cov(rows[:9].T)) == pytest.approx(least_determinant(rows, kept), rel=1e-9)


@pytest.mark.parametrize("outlier_ratio", [0.0, 0.25, 0.5])
def test_gaussian_ground_keeps_its_mean_and_covariance(outlier_ratio):
    found = robust_scatter(ground(3, 40_000), outlier_ratio)
    np.testing.assert_allclose(found.mean, MEAN, atol=0.02)
    whitened = np.linalg.solve(ROOT, np.linalg.solve(ROOT, found.covariance).T)
    np.testing.assert_allclose(whitened, np.eye(3), atol=0.05)
    assert found.is_inlier.mean() == pytest.approx(0.975, abs=0.005)


@settings(max_examples=20, deadline=None)
@given(SEEDS, st.sampled_from([[0.0, 3.0, 0.0], [4.0, 0.0, 0.0], [-3.0, 2.9, 6.0]]))
def test_a_fifth_of_something_else_shifts_nothing(seed, off):
    rows = ground(seed, 1000)
    rows[:200] = rows[:200] * [1.0, 0.1, 1.0] + off
    found, clean = robust_scatter(rows, 0.25), robust_scatter(rows[200:], 0.25)
    assert not found.is_inlier[:200].any()
    np.testing.assert_allclose(found.mean, clean.mean, atol=0.05)
    np.testing.assert_allclose(found.covariance, clean.covariance, atol=0.2)  # 0.13 at most in 7,500 draws


def test_units_and_datum_do_not_matter():
    rows = ground(5, 500)
    scale, shift = np.array([1000.0, 57.3, 0.1]), np.array([-4.0, 2.0, 9.0])
    a, b = robust_scatter(rows, 0.25), robust_scatter(rows * scale + shift, 0.25)
    np.testing.assert_allclose(b.mean, a.mean * scale + shift, rtol=1e-9)
    np.testing.assert_allclose(b.covariance, a.covariance * np.outer(scale, scale), rtol=1e-7, atol=1e-9)
    assert (a.is_inlier == b.is_inlier).all()


def test_a_feature_that_is_mostly_one_value_is_taken_for_it():
    rows = ground(7, 300)
    rows[:280, 2] = -13.8
    found = robust_scatter(rows, 0.25)
    assert found.mean[2] == pytest.approx(-13.8)
    assert not found.is_inlier[280:].any()
    assert np.isfinite(found.covariance).all()


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
    return VoxelFeatures(keys, features, np.ones(len(keys), np.int64)), is_post


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
    voxels = VoxelFeatures(keys, rng.normal(0, 1, (len(keys), 3)), np.ones(len(keys), np.int64))
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
