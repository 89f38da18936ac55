"""Variances of sums of correlated frames: against processes whose variance is known, and silent where it must be."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.signal import lfilter

from stone.scoring.sampling_variance import FEWEST_DEGREES, FEWEST_USED, SamplingVariances, sampling_variances
from stone.scoring.spectra import MOST_USED, coefficients, layout_of

Floats = NDArray[np.float64]


def first_order(rows: int, frames: int, rho: float, seed: int = 0) -> Floats:
    """Rows of a process of variance 1, (rows, frames)."""
    drive = np.random.default_rng(seed).standard_normal((rows, frames))
    drive[:, 1:] *= np.sqrt(1 - rho**2)
    return np.asarray(lfilter([1.0], [1.0, -rho], drive, axis=1))


def variances(rows: Floats, lengths: list[int]) -> SamplingVariances:
    layout = layout_of(lengths)
    return sampling_variances(coefficients(rows.T, layout).T, layout)


def true_variance(frames: int, rho: float) -> float:
    """Of the sum of that many frames: Σ Σ ρ^|i − j|."""
    lags = np.arange(1, frames)
    return float(frames + 2 * ((frames - lags) * rho**lags).sum())


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9])
@pytest.mark.parametrize("lengths", [[2400], [800, 800, 800], [1500, 600, 300]])
def test_the_variance_is_that_of_the_process(rho: float, lengths: list[int]) -> None:
    found = variances(first_order(600, sum(lengths), rho), lengths)
    expected = sum(true_variance(frames, rho) for frames in lengths)
    known = found.variance[found.is_known]
    assert len(known) > 400
    assert np.mean(known) == pytest.approx(expected, rel=0.08)


@pytest.mark.parametrize("rho", [0.9, 0.95])
def test_a_correlation_time_that_is_allowed_for_is_hardly_ever_far_too_short(rho: float) -> None:
    found = variances(first_order(600, 3000, rho), [1000] * 3).correlation_frames
    too_short = found < (1 + rho) / (1 - rho) / 2
    assert too_short.sum() <= 0.02 * 600


def test_few_frames_that_are_alike_say_nothing() -> None:
    assert not variances(first_order(200, 200, 0.98), [200]).is_known.any()


def test_slow_wander_behind_the_noise_of_single_frames_is_seen() -> None:
    rows = np.sqrt(0.3) * first_order(300, 3600, 0.95) + np.sqrt(0.7) * first_order(300, 3600, 0.0, seed=1)
    found = variances(rows, [1200] * 3)
    expected = 0.3 * 3 * true_variance(1200, 0.95) + 0.7 * 3600
    assert np.mean(found.variance[found.is_known]) == pytest.approx(expected, rel=0.1)


@given(st.floats(1e-6, 1e6), st.integers(0, 50))
def test_a_variance_grows_with_the_square_and_nothing_else_changes(scale: float, seed: int) -> None:
    rows = first_order(3, 900, 0.5, seed)
    one, other = variances(rows, [500, 400]), variances(scale * rows, [500, 400])
    np.testing.assert_allclose(other.variance, scale**2 * one.variance, rtol=1e-6)
    np.testing.assert_allclose(other.degrees, one.degrees, rtol=1e-6)
    np.testing.assert_array_equal(other.correlation_frames, one.correlation_frames)


@given(st.integers(0, 50))
def test_the_order_of_sequences_does_not_matter(seed: int) -> None:
    first, second = first_order(4, 500, 0.5, seed), first_order(4, 300, 0.5, seed + 100)
    one = variances(np.hstack([first, second]), [500, 300])
    other = variances(np.hstack([second, first]), [300, 500])
    np.testing.assert_allclose(one.variance, other.variance)


@given(st.integers(0, 50), st.sampled_from([0.0, 0.9]))
def test_degrees_of_freedom_are_those_of_a_few_coefficients(seed: int, rho: float) -> None:
    found = variances(first_order(5, 2000, rho, seed), [400] * 5)
    known = found.degrees[found.is_known]
    assert np.all((known >= FEWEST_DEGREES) & (known <= MOST_USED))


@given(st.lists(st.integers(1, 3), min_size=1, max_size=4))
def test_of_a_few_frames_nothing_is_known(lengths: list[int]) -> None:
    assert not variances(first_order(2, sum(lengths), 0.0), lengths).is_known.any()


def test_what_does_not_wander_or_is_not_finite_is_not_known_and_harms_no_other() -> None:
    rows = first_order(3, 900, 0.0)
    alone = variances(rows[2:], [900])
    rows[0], rows[1, 7] = 0.5, np.nan
    found = variances(rows - np.array([[0.5], [0.0], [0.0]]), [900])
    assert found.is_known.tolist() == [False, False, True]
    assert found.variance[2] == pytest.approx(alone.variance[0])


def test_sequences_too_short_for_a_coefficient_are_held_to_be_as_the_others_unless_they_are_many() -> None:
    assert variances(first_order(50, 1230, 0.5), [1200, 30]).is_known.mean() > 0.9
    assert not variances(first_order(50, 1200, 0.9), [20] * 60).is_known.any()
    assert not variances(first_order(50, FEWEST_USED - 1, 0.0), [FEWEST_USED - 1]).is_known.any()
