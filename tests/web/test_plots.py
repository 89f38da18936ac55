"""Numbers as SVG: scales keep order, ticks are round and within, thinning keeps what can be seen, shares add up."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from web.plots.paths import dots, known_runs, line, thinned
from web.plots.scales import Scale, duration_text, nice_ends, nice_step, signed_log_ticks, tick_text, ticks
from web.plots.time_plot import HEIGHT_PX, WIDTH, stacked_shares

finite = st.floats(-1e9, 1e9, allow_nan=False)
spans = st.floats(1e-6, 1e9)


def pairs(path: str) -> list[tuple[float, float]]:
    return [(float(x), float(y)) for x, y in re.findall(r"(-?[\d.]+) (-?[\d.]+)", path)]


@given(low=finite, span=spans, values=st.lists(finite, min_size=2, max_size=20))
@pytest.mark.parametrize("bend", [0.0, 1.0])
def test_a_scale_keeps_the_order_of_values_and_stays_within_its_ends(
    low: float, span: float, values: list[float], bend: float
) -> None:
    places = Scale(low, low + span, 0.0, WIDTH, bend).at(np.sort(values))
    assert (np.diff(places) >= -1e-9).all()
    assert places.min() >= 0.0
    assert places.max() <= WIDTH


def test_a_scale_places_its_ends_at_its_ends_also_upside_down() -> None:
    up = Scale(2.0, 4.0, 100.0, 0.0)
    assert [up.one(value) for value in (2.0, 3.0, 4.0, 9.0)] == [100.0, 50.0, 0.0, 0.0]


def test_a_scale_without_length_places_everything_in_its_middle_but_what_is_unknown() -> None:
    places = Scale(5.0, 5.0, 0.0, 10.0).at(np.array([5.0, np.nan]))
    assert places[0] == 5.0
    assert np.isnan(places[1])


@given(low=st.floats(-1e5, 1e5), span=st.floats(1e-3, 1e9), most=st.integers(1, 12))
def test_ticks_are_multiples_of_one_two_or_five_within_the_axis_and_not_too_many(
    low: float, span: float, most: int
) -> None:
    step = nice_step(span, most)
    assert f"{step:e}"[0] in "125"
    high = low + span
    found = ticks(low, high, most)
    assert len(found) <= most + 2
    assert all(low - step * 1e-3 <= tick <= high + step * 1e-3 for tick in found)


@given(low=st.floats(-1e6, 1e6), span=st.floats(0, 1e6))
def test_nice_ends_hold_the_values_and_are_never_one(low: float, span: float) -> None:
    first, last = nice_ends(low, low + span)
    slack = 1e-6 * max(1.0, abs(low), span)
    assert first <= low + slack
    assert last >= low + span - slack
    assert last > first


def test_signed_ticks_are_powers_of_ten_of_either_sign_around_zero() -> None:
    assert signed_log_ticks(-100.0, 100.0, 1.0) == [-100.0, -10.0, -1.0, 0.0, 1.0, 10.0, 100.0]
    assert signed_log_ticks(-1.0, 5e7, 1.0) == [-1.0, 0.0, 1.0, 100.0, 1e4, 1e6]


@pytest.mark.parametrize(
    ("value", "step", "said"), [(0.5, 0.5, "0.5"), (-20.0, 20.0, "−20"), (-0.0, 1.0, "0"), (12000.0, 2000.0, "12,000")]
)
def test_a_tick_has_the_decimals_of_its_step_and_a_real_minus(value: float, step: float, said: str) -> None:
    assert tick_text(value, step) == said


@pytest.mark.parametrize(
    ("value_ns", "said"),
    [(0, "0 ns"), (124_135, "124 µs"), (22e6, "22 ms"), (-37e9, "−37 s"), (3.6e12, "3,600 s"), (999_999_999, "1 s")],
)
def test_a_time_is_said_in_the_unit_that_suits_it(value_ns: float, said: str) -> None:
    assert duration_text(value_ns) == said


def test_a_line_breaks_where_nothing_is_known_and_a_lone_point_is_a_dot() -> None:
    y = np.array([1.0, 2.0, np.nan, 4.0, np.nan])
    assert known_runs(y) == [(0, 2), (3, 4)]
    assert line(np.arange(5.0), y) == "M0 1L1 2 M3 4h0"
    assert line(np.empty(0), np.empty(0)) == ""
    assert dots(np.arange(5.0), y).count("h0") == 3


@given(st.lists(finite, min_size=1, max_size=400), st.integers(1, 20))
def test_thinning_keeps_first_last_lowest_and_highest_and_invents_nothing(values: list[float], columns: int) -> None:
    x, y = np.arange(float(len(values))), np.array(values)
    kept_x, kept_y = thinned(x, y, columns)
    assert (kept_x[0], kept_x[-1]) == (x[0], x[-1])
    assert (kept_y.min(), kept_y.max()) == (y.min(), y.max())
    assert len(kept_x) <= max(4 * columns, 1)
    assert all(y[int(at)] == value for at, value in zip(kept_x, kept_y, strict=True))


@given(st.lists(st.tuples(*[st.integers(0, 10**7)] * 3), min_size=2, max_size=50))
def test_stacked_shares_fill_the_whole_height_wherever_there_is_something(counts: list[tuple[int, int, int]]) -> None:
    table = np.array(counts, np.float64)
    bottom, middle, top = stacked_shares(np.arange(float(len(counts))), table, ("a", "b", "c"))
    upper_of_top = pairs(top.path)[: len(counts)]
    lower_of_bottom = pairs(bottom.path)[len(counts) :]
    for (_, y), total in zip(upper_of_top, table.sum(axis=1), strict=True):
        assert y == pytest.approx(0.0 if total else HEIGHT_PX, abs=0.1)
    assert {y for _, y in lower_of_bottom} == {HEIGHT_PX}
    assert pairs(middle.path)[: len(counts)] == list(reversed(pairs(top.path)[len(counts) :]))
