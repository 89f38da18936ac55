"""The minimum covariance determinant against every subset, against Gaussians and against what would spoil it."""

import math
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stone.labels.robust_scatter import robust_scatter

SEEDS = st.integers(0, 2**32)
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
    np.testing.assert_allclose(found.covariance, clean.covariance, atol=0.12)


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
