"""Coverage and rates against closed forms and slow counts."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from stone_recordings.report.quality.coverage import COVER_BINS, covered_bins, covered_ratio, rates

S = 1_000_000_000
STEPS = st.lists(st.integers(1_000_000, 3 * S), min_size=4, max_size=80)


def every(period_s: float, start_s: float, stop_s: float) -> NDArray[np.int64]:
    return (np.arange(start_s, stop_s, period_s) * S).astype(np.int64)


def test_a_topic_without_gaps_is_wholly_covered() -> None:
    times = every(0.1, 0.0, 20.05)
    assert covered_ratio(times, 20 * S, S // 4) == 1.0
    assert covered_bins(times, 20 * S, S // 4) == pytest.approx(1.0)


def test_a_pause_of_a_fifth_leaves_four_fifths() -> None:
    times = np.concatenate([every(0.1, 0.0, 8.05), every(0.1, 12.0, 20.05)])
    assert covered_ratio(times, 20 * S, S // 4) == pytest.approx(0.8)
    bins = covered_bins(times, 20 * S, S // 4)
    assert bins.mean() == pytest.approx(0.8)
    assert (bins[33:47] == 0).all()
    assert bins[:31] == pytest.approx(1.0)
    assert bins[49:] == pytest.approx(1.0)


@pytest.mark.parametrize(("start_s", "stop_s", "ratio"), [(0.9, 19.1, 1.0), (5.0, 20.05, 0.75), (0.0, 10.05, 0.5)])
def test_starting_late_by_a_second_costs_nothing_and_by_more_costs_all_of_it(
    start_s: float, stop_s: float, ratio: float
) -> None:
    assert covered_ratio(every(0.1, start_s, stop_s), 20 * S, S // 4) == pytest.approx(ratio, abs=0.01)


@given(steps=STEPS, longest_ns=st.integers(1_000_000, 2 * S), head=st.integers(0, 5 * S), tail=st.integers(0, 5 * S))
def test_bins_add_up_to_the_covered_steps(steps: list[int], longest_ns: int, head: int, tail: int) -> None:
    times = np.cumsum([head, *steps]).astype(np.int64)
    span_ns = int(times[-1]) + tail
    bins = covered_bins(times, span_ns, longest_ns)
    assert bins.shape == (COVER_BINS,)
    assert ((bins >= 0) & (bins <= 1)).all()
    covered_ns = sum(step for step in steps if step <= longest_ns)
    assert bins.sum() * span_ns / COVER_BINS == pytest.approx(covered_ns, rel=1e-9, abs=1.0)


@given(steps=STEPS, longest_ns=st.integers(1_000_000, 2 * S), head=st.integers(0, 5 * S), tail=st.integers(0, 5 * S))
def test_the_covered_share_is_a_share(steps: list[int], longest_ns: int, head: int, tail: int) -> None:
    times = np.cumsum([head, *steps]).astype(np.int64)
    assert 0 <= covered_ratio(times, int(times[-1]) + tail, longest_ns) <= 1


@pytest.mark.parametrize("rate_hz", [1.0, 10.0, 200.0])
@pytest.mark.parametrize("start_s", [0.0, 3.37])
def test_a_steady_topic_has_its_rate_in_every_bin_in_which_it_speaks(rate_hz: float, start_s: float) -> None:
    found = rates(every(1 / rate_hz, start_s, 60.0), 60 * S)
    assert len(found) == min(48, round((60 - start_s) * rate_hz) // 5)
    assert found[found > 0] == pytest.approx(rate_hz, rel=1e-6)
    assert (found > 0).sum() >= len(found) * (60 - start_s) / 60 - 1


def test_a_rate_that_halves_is_seen_to_halve() -> None:
    found = rates(np.concatenate([every(0.05, 0, 30), every(0.1, 30, 60)]), 60 * S)
    assert found[:23] == pytest.approx(20.0)
    assert found[25:] == pytest.approx(10.0)
