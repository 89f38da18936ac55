"""The reference against numpy and scipy's own definitions; what alpha and the floor do."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import mahalanobis

from stone.labels.traversability import (
    NON_TRAVERSABLE,
    POTENTIAL,
    TRAVERSABLE,
    NoReferenceError,
    ReferenceParameters,
    classify,
    distance_squared,
    reference_of,
    sums_of,
    threshold,
    total_of,
)

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
    strict, lenient = (classify(features, none, made, alpha) == POTENTIAL for alpha in (max(a, b), min(a, b)))
    assert (lenient | ~strict).all()


def test_driven_voxels_are_traversable_whatever_they_look_like():
    made = reference(driven(1))
    features = np.stack([made.mean, made.mean + 100, made.mean, made.mean + 100])
    classes = classify(features, np.array([True, True, False, False]), made, 0.05)
    assert classes.tolist() == [TRAVERSABLE, TRAVERSABLE, POTENTIAL, NON_TRAVERSABLE]
    assert classes.dtype == np.uint8


@pytest.mark.parametrize("count", [0, 3])
def test_too_few_driven_voxels_make_no_reference(count):
    with pytest.raises(NoReferenceError, match=f"the track covers {count} surface voxels and the reference needs"):
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
