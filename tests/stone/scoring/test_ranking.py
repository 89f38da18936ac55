"""Ranks, paired differences and tie groups: against the slow and obvious way, and by what must always hold."""

from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from stone.errors import ShapeError
from stone.scoring.ranking import (
    MOST_EXACT,
    RANDOM_FLIPS,
    in_order,
    paired,
    rank_intervals,
    shared_ranks,
    sign_flip,
    tie_groups,
)

Floats = NDArray[np.float64]
# Few values, so that equal ones are common; NaN is what a draw leaves undefined.
RATIOS = st.sampled_from([0.1, 0.2, 0.3, 0.4, 0.5])
SHAPES = st.tuples(st.integers(1, 6), st.integers(1, 12))
DRAWS = SHAPES.flatmap(lambda shape: arrays(np.float64, shape, elements=RATIOS))
DRAWS_WITH_GAPS = SHAPES.flatmap(
    lambda shape: arrays(np.float64, shape, elements=st.one_of(RATIOS, st.just(float("nan"))))
)


def slow_ranks(replicates: Floats) -> Floats:
    """(n, 2, D): the best and worst rank of each entry, counted one by one."""
    entries, count = replicates.shape
    ranks = np.empty((entries, 2, count))
    for i, d in product(range(entries), range(count)):
        mine = replicates[i, d]
        others = [replicates[j, d] for j in range(entries) if j != i]
        if np.isnan(mine):
            ranks[i, :, d] = 1, entries
            continue
        ranks[i, 0, d] = 1 + sum(other > mine for other in others)
        ranks[i, 1, d] = 1 + sum(not other < mine for other in others)
    return ranks


def nth_smallest(values: Floats, share: float) -> float:
    """The smallest value that at least this share of the values does not exceed."""
    return next(float(value) for value in sorted(values) if np.mean(values <= value) >= share - 1e-12)


def noisy(seed: int, means: list[float], own: float, replicates: int = 2000) -> Floats:
    """Entries that share the difficulty of the ground, each with a little of its own."""
    random = np.random.default_rng(seed)
    shared = random.normal(0, 0.05, replicates)
    return np.array([mean + shared + random.normal(0, own, replicates) for mean in means])


@given(DRAWS_WITH_GAPS)
def test_rank_intervals_are_those_counted_one_by_one(replicates: Floats) -> None:
    ranks = slow_ranks(replicates)
    expected = [[nth_smallest(best, 0.025), nth_smallest(worst, 0.975)] for best, worst in ranks]
    assert rank_intervals(replicates).tolist() == expected


@given(DRAWS_WITH_GAPS, st.integers(0, 99))
def test_rank_intervals_do_not_depend_on_the_order_of_entries(replicates: Floats, seed: int) -> None:
    places = np.random.default_rng(seed).permutation(len(replicates))
    assert np.array_equal(rank_intervals(replicates)[places], rank_intervals(replicates[places]))


@given(DRAWS)
def test_a_rank_interval_lies_among_the_ranks_there_are(replicates: Floats) -> None:
    low, high = rank_intervals(replicates).T
    assert np.all((low >= 1) & (low <= high) & (high <= len(replicates)))


@given(DRAWS)
def test_a_dominating_entry_ranks_first_and_nowhere_else(replicates: Floats) -> None:
    assert rank_intervals(np.vstack([replicates, np.ones(replicates.shape[1])]))[-1].tolist() == [1, 1]


@given(DRAWS)
def test_equal_entries_share_their_interval_and_their_group(replicates: Floats) -> None:
    twice = np.vstack([replicates[:1], replicates[:1]])
    assert rank_intervals(twice).tolist() == [[1, 2], [1, 2]]
    assert tie_groups(twice).tolist() == [1, 1]
    same = paired(replicates[0], replicates[0])
    assert (same.interval, same.share_above, same.p) == ((0.0, 0.0), 0.5, 1.0)


def test_what_is_never_defined_may_have_any_rank() -> None:
    replicates = np.array([[np.nan] * 9, [0.9] * 9, [0.1] * 9])
    assert rank_intervals(replicates).tolist() == [[1, 3], [1, 2], [2, 3]]


@given(DRAWS_WITH_GAPS)
def test_a_paired_difference_is_the_other_way_round_when_the_entries_are(replicates: Floats) -> None:
    a, b = replicates[0], replicates[-1]
    there, back = paired(a, b), paired(b, a)
    assert there.p == back.p
    assert there.share_above == pytest.approx(1 - back.share_above)
    assert (there.interval is None) == bool(np.isnan(a - b).any())
    if there.interval and back.interval:
        assert there.interval == pytest.approx((-back.interval[1], -back.interval[0]))


@given(DRAWS_WITH_GAPS)
def test_a_p_counts_the_draws_that_do_not_speak_for_the_better_one(replicates: Floats) -> None:
    a, b = replicates[0], replicates[-1]
    against = min(sum(not x > y for x, y in zip(a, b, strict=True)), sum(not x < y for x, y in zip(a, b, strict=True)))
    assert paired(a, b).p == pytest.approx(min(1.0, 2 * (against + 1) / (len(a) + 1)))


@settings(max_examples=20)
@given(st.integers(0, 1000), st.floats(0, 0.01))
def test_a_paired_interval_is_narrower_than_the_separate_ones_together(seed: int, apart: float) -> None:
    a, b = noisy(seed, [0.5 + apart, 0.5], own=0.005)
    of_difference = paired(a, b).interval
    assert of_difference is not None
    separate = [np.subtract(*np.quantile(replicates, [0.975, 0.025])) for replicates in (a, b)]
    assert of_difference[1] - of_difference[0] < sum(separate) / 2


def test_entries_with_overlapping_intervals_are_told_apart_by_their_differences() -> None:
    replicates = noisy(3, [0.52, 0.50], own=0.002)
    bounds = np.quantile(replicates, [0.025, 0.975], axis=1).T
    assert bounds[0][0] < bounds[1][1], "the separate intervals overlap"
    assert tie_groups(replicates).tolist() == [1, 2]


def test_a_group_ends_where_an_entry_is_surely_below_its_first() -> None:
    replicates = noisy(4, [0.60, 0.599, 0.55, 0.549, 0.3], own=0.004)
    assert tie_groups(replicates).tolist() == [1, 1, 2, 2, 3]


@given(DRAWS)
def test_groups_only_ever_go_on_or_up_by_one(replicates: Floats) -> None:
    groups = tie_groups(replicates)
    assert groups[0] == 1
    assert set(np.diff(groups)) <= {0, 1}


def test_an_entry_that_is_undefined_in_draws_is_not_surely_below() -> None:
    assert tie_groups(np.array([[0.9] * 9, [0.1] * 8 + [np.nan]])).tolist() == [1, 1]


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


def test_draws_that_do_not_belong_together_are_refused() -> None:
    with pytest.raises(ShapeError, match="as those of the other entry"):
        paired(np.zeros(3), np.zeros(4))
    with pytest.raises(ShapeError, match="at least one draw"):
        paired(np.zeros(0), np.zeros(0))
    with pytest.raises(ShapeError, match="at least one draw"):
        rank_intervals(np.zeros((3, 0)))
    assert rank_intervals(np.zeros((0, 5))).shape == (0, 2)
    assert tie_groups(np.zeros((0, 5))).shape == (0,)
