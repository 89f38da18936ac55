"""Ranks, spectra and variances: against the slow and obvious way, and processes whose variance is known."""

from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.signal import lfilter

from stone.errors import ShapeError
from stone.scoring.ranking import (
    MOST_EXACT,
    RANDOM_FLIPS,
    in_order,
    rank_intervals,
    shared_ranks,
    sign_flip,
    tie_groups,
)
from stone.scoring.spectra import (
    FEWEST_DEGREES,
    FEWEST_USED,
    FRAMES_PER_PERIOD,
    MOST_USED,
    OCTAVES_ABOVE,
    SamplingVariances,
    coefficients,
    layout_of,
    sampling_variances,
    sums_of_sequences,
)
from testing.worlds.correlated_scores import fractional

LENGTHS = st.lists(st.integers(1, 700), min_size=1, max_size=5)
Floats = NDArray[np.float64]


def slow_coefficients(influences: Floats, lengths: list[int], kept: tuple[int, ...]) -> Floats:
    """The oracle: cosine by cosine."""
    found, first = [], 0
    for frames, count in zip(lengths, kept, strict=True):
        own, t = influences[first : first + frames], np.arange(frames)
        for j in range(count):
            norm = np.sqrt((1 if j == 0 else 2) / frames)
            found.append(norm * (np.cos(np.pi * j * (t + 0.5) / frames)[:, None] * own).sum(axis=0))
        first += frames
    return np.array(found)


@settings(max_examples=20, deadline=None)
@given(LENGTHS, st.integers(0, 99))
def test_coefficients_are_those_of_the_definition(lengths: list[int], seed: int) -> None:
    layout = layout_of(lengths)
    influences = np.random.default_rng(seed).normal(size=(sum(lengths), 2))
    expected = slow_coefficients(influences, lengths, layout.kept)
    np.testing.assert_allclose(coefficients(influences, layout), expected, atol=1e-9)


@settings(max_examples=20, deadline=None)
@given(LENGTHS, st.integers(0, 99))
def test_sums_of_sequences_are_read_from_them(lengths: list[int], seed: int) -> None:
    influences = np.random.default_rng(seed).normal(size=(sum(lengths), 3))
    bounds = np.cumsum([0, *lengths])[:-1]
    found = sums_of_sequences(coefficients(influences, layout_of(lengths)), layout_of(lengths))
    np.testing.assert_allclose(found, np.add.reduceat(influences, bounds, axis=0), atol=1e-9)


@settings(max_examples=20, deadline=None)
@given(LENGTHS)
def test_no_more_is_kept_than_inference_looks_at_and_no_less(lengths: list[int]) -> None:
    layout = layout_of(lengths)
    used = layout.used(layout.shortest_period_frames)
    assert used.sum() <= MOST_USED
    assert np.all(np.array(layout.kept) <= lengths)
    assert sum(layout.kept) <= len(lengths) + MOST_USED * 2**OCTAVES_ABOVE
    assert np.all(np.array(layout.kept) > used)


@settings(max_examples=20, deadline=None)
@given(LENGTHS)
def test_steps_of_period_are_those_of_the_frequencies(lengths: list[int]) -> None:
    layout = layout_of(lengths)
    assert len(layout.steps) == len(layout.frequencies) == sum(layout.kept)
    for step, frequency in zip(layout.steps.tolist(), layout.frequencies.tolist(), strict=True):
        if step > -1000:
            period = np.pi / (FRAMES_PER_PERIOD * frequency)
            assert layout.period_frames(step) <= period * (1 + 1e-6)
            assert period < layout.period_frames(step + 1) * (1 + 1e-6)


def test_lengths_that_do_not_add_up_are_refused() -> None:
    for lengths in ([4, 4], [9, 0], []):
        with pytest.raises(ShapeError):
            coefficients(np.zeros((9, 5)), layout_of(lengths))


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
def test_the_variance_is_that_of_the_process_or_more_as_long_memory_is_likely(rho: float, lengths: list[int]) -> None:
    found = variances(first_order(600, sum(lengths), rho), lengths)
    expected = sum(true_variance(frames, rho) for frames in lengths)
    known = found.variance[found.is_known] / expected
    assert len(known) > 400
    assert np.mean(known) > 0.92
    assert np.quantile(known, 0.1) < 1
    assert np.median(known) < 3


@pytest.mark.parametrize("hurst", [0.7, 0.8, 0.9])
@pytest.mark.parametrize("lengths", [[2400], [800, 800, 800], [1500, 600, 300]])
def test_under_long_memory_the_variance_is_not_far_too_small(hurst: float, lengths: list[int]) -> None:
    """Of the sum of n frames of fractional Gaussian noise it is n²ᴴ; by short memory alone a 4th to a 50th of it."""
    random = np.random.default_rng(1)
    rows = np.hstack([np.vstack([fractional(hurst, random, frames) for _ in range(100)]) for frames in lengths])
    found = variances(rows, lengths)
    expected = float((np.array(lengths, float) ** (2 * hurst)).sum())
    assert found.is_known.sum() > 100
    assert np.median(found.variance[found.is_known]) > 0.6 * expected


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
    assert np.mean(found.variance[found.is_known]) > 0.9 * expected


@settings(max_examples=20, deadline=None)
@given(st.floats(1e-6, 1e6), st.integers(0, 50))
def test_a_variance_grows_with_the_square_and_nothing_else_changes(scale: float, seed: int) -> None:
    rows = first_order(3, 900, 0.5, seed)
    one, other = variances(rows, [500, 400]), variances(scale * rows, [500, 400])
    np.testing.assert_allclose(other.variance, scale**2 * one.variance, rtol=1e-6)
    np.testing.assert_allclose(other.degrees, one.degrees, rtol=1e-6)
    np.testing.assert_array_equal(other.correlation_frames, one.correlation_frames)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 50))
def test_the_order_of_sequences_does_not_matter(seed: int) -> None:
    first, second = first_order(4, 500, 0.5, seed), first_order(4, 300, 0.5, seed + 100)
    one = variances(np.hstack([first, second]), [500, 300])
    other = variances(np.hstack([second, first]), [300, 500])
    np.testing.assert_allclose(one.variance, other.variance)


@settings(max_examples=20, deadline=None)
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


Claims = NDArray[np.bool_]


def chain(values: list[float], apart: float) -> Claims:
    """Who is above whom by more than `apart`."""
    found = np.asarray(values)
    return np.subtract.outer(found, found) > apart


VALUES = st.lists(st.floats(0, 1), min_size=1, max_size=8)


@given(VALUES, st.floats(0, 0.5))
def test_a_rank_interval_counts_who_is_surely_above_and_below(values: list[float], apart: float) -> None:
    above = chain(values, apart)
    for place, (low, high) in enumerate(rank_intervals(above).tolist()):
        assert low == 1 + sum(bool(above[other, place]) for other in range(len(values)))
        assert high == len(values) - sum(bool(above[place, other]) for other in range(len(values)))


def test_where_nobody_is_surely_above_anybody_all_are_one_group() -> None:
    nobody = np.zeros((3, 3), np.bool_)
    assert rank_intervals(nobody).tolist() == [[1, 3]] * 3
    assert tie_groups(nobody).tolist() == [1, 1, 1]


def test_a_group_ends_where_an_entry_is_surely_below_its_first() -> None:
    assert tie_groups(chain([0.60, 0.599, 0.55, 0.549, 0.3], 0.01)).tolist() == [1, 1, 2, 2, 3]


@given(VALUES, st.floats(0, 0.5))
def test_groups_only_ever_go_on_or_up_by_one(values: list[float], apart: float) -> None:
    groups = tie_groups(chain(sorted(values, reverse=True), apart))
    assert groups[0] == 1
    assert set(np.diff(groups)) <= {0, 1}


@given(st.lists(st.floats(-1, 1), min_size=1, max_size=8))
def test_the_sign_flip_p_is_that_of_all_flips(differences: list[float]) -> None:
    assume(all(abs(one) > 1e-6 or one == 0 for one in differences))
    observed = abs(sum(differences))
    flipped = [abs(sum(s * v for s, v in zip(signs, differences, strict=True))) for signs in _signs(len(differences))]
    expected = np.mean([value >= observed - 1e-9 for value in flipped])
    result = sign_flip(differences)
    assert result.p == pytest.approx(expected)
    assert result.p >= result.smallest_p == 2 / 2 ** len(differences)


def test_without_a_sequence_nothing_is_shown() -> None:
    assert (sign_flip([]).sequences, sign_flip([]).p, sign_flip([]).smallest_p) == (0, 1.0, 1.0)


def test_many_sequences_are_flipped_at_random_and_the_same_way_each_time() -> None:
    random = np.random.default_rng(1)
    many = list(random.normal(0.2, 1, MOST_EXACT + 4))
    assert sign_flip(many) == sign_flip(many)
    assert sign_flip([0.5] * (MOST_EXACT + 4)).p == pytest.approx(2 / RANDOM_FLIPS)
    assert sign_flip(list(random.normal(0, 1, MOST_EXACT + 4))).p > 0.05


def _signs(count: int) -> list[tuple[int, ...]]:
    return list(product((1, -1), repeat=count))


KEYS = st.lists(st.lists(st.sampled_from([0.1, 0.2, 0.3]), min_size=3, max_size=3), min_size=1, max_size=8)


@given(KEYS)
def test_the_order_is_by_each_key_in_turn_and_then_as_given(keys: list[list[float]]) -> None:
    places = in_order(keys)
    assert sorted(places) == list(range(len(keys)))
    for before, after in pairwise(places):
        assert (keys[before], -before) > (keys[after], -after)


@given(KEYS)
def test_equal_keys_share_a_rank_and_the_next_rank_counts_them(keys: list[list[float]]) -> None:
    ordered = sorted(keys, reverse=True)
    assert shared_ranks(ordered) == [1 + sum(other > key for other in ordered) for key in ordered]
