"""All pairs at once: against scipy's studentised range, and on boards whose truth is known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from stone.errors import ShapeError
from stone.scoring.intervals import ratio_spectra
from stone.scoring.pairs import BoardSpectra, range_quantile, surely_above
from stone.scoring.ranking import tie_groups
from stone.scoring.spectra import coefficients, layout_of

LENGTHS = (400,) * 4


def board(means: list[float], own: float, seed: int) -> tuple[np.ndarray, BoardSpectra]:
    """Entries that share the difficulty of the ground, each with a little of its own; frames are independent."""
    random, layout = np.random.default_rng(seed), layout_of(LENGTHS)
    shared = random.normal(0, 0.2, sum(LENGTHS))
    frames = np.array([mean + shared + random.normal(0, own, sum(LENGTHS)) for mean in means])
    values = frames.mean(axis=1)
    influences = (frames - values[:, None]) / sum(LENGTHS)
    return values, BoardSpectra(layout, coefficients(influences.T, layout).T, np.ones(len(means)))


@pytest.mark.parametrize("entries", [2, 3, 10, 100, 500])
@pytest.mark.parametrize("degrees", [3, 5, 12, 24])
def test_the_quantile_is_that_of_scipy(entries: int, degrees: int) -> None:
    expected = stats.studentized_range.isf(0.05, entries, degrees)
    assert range_quantile(entries, degrees) == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("degrees", [3, 8, 24])
def test_of_two_entries_it_is_students_t(degrees: int) -> None:
    assert range_quantile(2, degrees) / np.sqrt(2) == pytest.approx(stats.t.isf(0.025, degrees), rel=1e-5)


@pytest.mark.parametrize("entries", [2, 8])
def test_any_two_of_equal_entries_are_told_apart_by_chance_only(entries: int) -> None:
    """The best of many lucky ones too: with pairs at 5 % each, eight equal entries are split in a third of boards."""
    trials, split = 150, 0
    for seed in range(trials):
        above = surely_above(*board([0.5] * entries, 0.1, seed))
        assert above is not None
        split += above.any()
    assert split <= stats.binom.ppf(1 - 1e-4, trials, 0.06)


def test_entries_that_differ_are_told_apart_though_their_intervals_overlap() -> None:
    values, spectra = board([0.50, 0.49], 0.02, seed=1)
    reach = 2 * np.hypot(0.2, 0.02) / np.sqrt(sum(LENGTHS))
    assert values[0] - reach < values[1] + reach
    above = surely_above(values, spectra)
    assert above is not None
    assert above.tolist() == [[False, True], [False, False]]
    assert tie_groups(above).tolist() == [1, 2]


@given(st.integers(0, 99), st.integers(2, 5))
@settings(max_examples=20)
def test_nobody_is_above_who_is_not_ahead_and_the_order_does_not_matter(seed: int, entries: int) -> None:
    means = np.random.default_rng(seed).uniform(0.4, 0.5, entries).tolist()
    values, spectra = board(means, 0.1, seed)
    above = surely_above(values, spectra)
    assert above is not None
    assert not (above & ~(np.subtract.outer(values, values) > 0)).any()
    places = np.random.default_rng(seed).permutation(entries)
    moved = BoardSpectra(spectra.layout, spectra.coefficients[places], spectra.spread[places])
    again = surely_above(values[places], moved)
    assert again is not None
    assert np.array_equal(again, above[np.ix_(places, places)])


def test_where_no_pair_says_anything_nothing_is_claimed() -> None:
    values, spectra = board([0.5, 0.4], 0.1, seed=0)
    for layout, kept, spread in (
        (spectra.layout, np.tile(spectra.coefficients[:1], (2, 1)), spectra.spread),
        (spectra.layout, spectra.coefficients, np.array([1.0, 0.2])),
        (layout_of([8]), np.ones((2, len(layout_of([8]).steps))), spectra.spread),
    ):
        assert surely_above(values, BoardSpectra(layout, kept, spread)) is None
    assert surely_above(values[:1], BoardSpectra(spectra.layout, spectra.coefficients[:1], spectra.spread[:1])) is None


def test_as_many_values_as_entries_are_asked_for() -> None:
    values, spectra = board([0.5, 0.4], 0.1, seed=0)
    with pytest.raises(ShapeError, match="one for each entry"):
        surely_above(values[:1], spectra)


def test_spectra_of_a_score_are_a_row_of_a_board() -> None:
    confusions = np.random.default_rng(0).integers(1, 99, (sum(LENGTHS), 4, 4))
    found = ratio_spectra(confusions, LENGTHS)
    of_board = BoardSpectra(found.layout, found.coefficients.T, found.spread)
    assert surely_above(np.linspace(0.1, 0.9, 5), of_board) is not None
