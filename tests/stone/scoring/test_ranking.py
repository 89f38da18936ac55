"""Ranks, tie groups and the sign-flip test: against the slow and obvious way, and by what must always hold."""

from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.typing import NDArray

from stone.scoring.ranking import (
    MOST_EXACT,
    RANDOM_FLIPS,
    in_order,
    rank_intervals,
    shared_ranks,
    sign_flip,
    tie_groups,
)

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


@given(VALUES, st.floats(0, 0.5))
def test_the_rank_by_value_lies_in_its_interval(values: list[float], apart: float) -> None:
    for value, (low, high) in zip(values, rank_intervals(chain(values, apart)).tolist(), strict=True):
        assert 1 <= low <= 1 + sum(other > value for other in values) <= high <= len(values)


@given(VALUES, st.floats(0, 0.5), st.integers(0, 99))
def test_rank_intervals_do_not_depend_on_the_order_of_entries(values: list[float], apart: float, seed: int) -> None:
    places = np.random.default_rng(seed).permutation(len(values))
    above = chain(values, apart)
    assert np.array_equal(rank_intervals(above)[places], rank_intervals(above[np.ix_(places, places)]))


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


def test_five_sequences_cannot_give_less_than_a_sixteenth_however_large_the_difference() -> None:
    assert sign_flip([0.9] * 5).p == sign_flip([0.9] * 5).smallest_p == 0.0625


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
