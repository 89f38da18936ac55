"""The line between two clocks gives back the offset, drift and jitter it was made with, whatever a few messages do."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.stats import theilslopes

from stone.sensors.clocks import BLOCKS, ClockLine, clock_line, interval_jitter_ns, robust_slope, spread

START_NS = 1_760_000_000_000_000_000
PERIOD_NS = 50_000_000
Stamps = NDArray[np.int64]
unhurried = settings(deadline=None, max_examples=40)


def _record_times_ns(count: int) -> Stamps:
    return np.asarray(START_NS + np.arange(count, dtype=np.int64) * PERIOD_NS, np.int64)


def _stamps_ns(record_times_ns: Stamps, offset_ns: int, drift_ppm: float) -> Stamps:
    """Of a clock that is `offset_ns` behind and runs fast by `drift_ppm`."""
    ahead_ns = np.rint((record_times_ns - record_times_ns[0]) * drift_ppm * 1e-6).astype(np.int64)
    return np.asarray(record_times_ns - offset_ns + ahead_ns, np.int64)


def told(stamps_ns: Stamps, record_times_ns: Stamps) -> ClockLine:
    line = clock_line(stamps_ns, record_times_ns)
    assert line is not None
    return line


@unhurried
@given(
    count=st.integers(8, 400),
    offset_ns=st.integers(-(10**12), 10**12),
    drift_ppm=st.floats(-200, 200),
)
def test_an_exact_clock_gives_its_offset_and_drift_back(count: int, offset_ns: int, drift_ppm: float) -> None:
    record_times_ns = _record_times_ns(count)
    line = told(_stamps_ns(record_times_ns, offset_ns, drift_ppm), record_times_ns)
    assert line.drift_ppm == pytest.approx(drift_ppm, abs=0.02)
    run_ns = (count - 1) * PERIOD_NS
    assert line.offset_ns == pytest.approx(offset_ns - run_ns / 2 * drift_ppm * 1e-6, abs=2)
    assert line.jitter_ns <= 2


@unhurried
@given(shift_ns=st.integers(-(10**15), 10**15), seed=st.integers(0, 1000))
def test_shifting_every_stamp_shifts_the_offset_and_nothing_else(shift_ns: int, seed: int) -> None:
    record_times_ns = _record_times_ns(100)
    noise_ns = np.random.default_rng(seed).integers(0, 3_000_000, 100)
    stamps_ns = record_times_ns - noise_ns
    here, there = told(stamps_ns, record_times_ns), told(stamps_ns + shift_ns, record_times_ns)
    assert there.offset_ns == here.offset_ns - shift_ns
    assert (there.drift_ppm, there.drift_sigma_ppm, there.jitter_ns) == (
        here.drift_ppm,
        here.drift_sigma_ppm,
        here.jitter_ns,
    )


@unhurried
@given(seed=st.integers(0, 500), shift_ns=st.integers(0, 10**17))
def test_moving_both_clocks_to_another_day_changes_nothing(seed: int, shift_ns: int) -> None:
    record_times_ns = _record_times_ns(80)
    stamps_ns = record_times_ns - np.random.default_rng(seed).integers(0, 3_000_000, 80)
    assert clock_line(stamps_ns + shift_ns, record_times_ns + shift_ns) == clock_line(stamps_ns, record_times_ns)


@unhurried
@given(seed=st.integers(0, 300))
def test_a_few_messages_that_hang_for_a_second_do_not_bend_the_line(seed: int) -> None:
    generator = np.random.default_rng(seed)
    record_times_ns = _record_times_ns(600)
    stamps_ns = _stamps_ns(record_times_ns, 12_000_000, 50.0) - generator.integers(0, 500_000, 600)
    late = generator.choice(600, 60, replace=False)
    stamps_ns[late] -= generator.integers(10**8, 10**9, 60)
    line = told(stamps_ns, record_times_ns)
    assert line.drift_ppm == pytest.approx(50.0, abs=5.0)
    assert line.jitter_ns < 400_000


@unhurried
@given(seed=st.integers(0, 300), count=st.integers(8, BLOCKS))
def test_up_to_a_block_of_samples_the_slope_is_scipys(seed: int, count: int) -> None:
    generator = np.random.default_rng(seed)
    x = np.sort(generator.uniform(0, 1e9, count))
    y = generator.normal(0, 1, count) + 1e-9 * x
    assert robust_slope(x, y) == pytest.approx(theilslopes(y, x).slope, rel=1e-9, abs=1e-18)


@unhurried
@given(seed=st.integers(0, 40))
def test_the_slope_of_blocks_is_that_of_all_pairs_within_its_standard_error(seed: int) -> None:
    generator = np.random.default_rng(seed)
    record_times_ns = _record_times_ns(500)
    stamps_ns = _stamps_ns(record_times_ns, 5_000_000, 30.0) - generator.normal(0, 300_000, 500).astype(np.int64)
    line = told(stamps_ns, record_times_ns)
    distance_ns = (record_times_ns - stamps_ns).astype(np.float64)
    every_pair = theilslopes(distance_ns, (record_times_ns - START_NS).astype(np.float64))
    assert line.drift_ppm is not None
    assert line.drift_sigma_ppm is not None
    assert abs(line.drift_ppm + every_pair.slope * 1e6) < 3 * line.drift_sigma_ppm
    assert line.jitter_ns == pytest.approx(300_000, rel=0.15)


def test_the_standard_error_covers_the_truth_as_often_as_it_says() -> None:
    record_times_ns = _record_times_ns(400)
    misses = []
    for seed in range(120):
        noise_ns = np.random.default_rng(seed).normal(0, 1_000_000, 400).astype(np.int64)
        line = told(record_times_ns - noise_ns, record_times_ns)
        misses.append((line.drift_ppm or 0.0) / (line.drift_sigma_ppm or 1.0))
    assert 0.8 < float(np.std(misses)) < 1.2


def test_too_few_messages_have_an_offset_and_no_drift() -> None:
    record_times_ns = _record_times_ns(7)
    line = told(record_times_ns - 3, record_times_ns)
    assert (line.offset_ns, line.drift_ppm, line.drift_sigma_ppm, line.jitter_ns) == (3, None, None, 0)
    assert clock_line(record_times_ns[:0], record_times_ns[:0]) is None


def test_messages_recorded_in_one_instant_have_no_drift() -> None:
    times_ns = np.full(50, START_NS, np.int64)
    line = told(times_ns - np.arange(50), times_ns)
    assert line.drift_ppm is None


@unhurried
@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=50), st.floats(-1e6, 1e6))
def test_the_spread_does_not_know_where_it_is(values: list[float], shift: float) -> None:
    array = np.array(values)
    assert spread(array + shift) == pytest.approx(spread(array), abs=1e-6)


def test_the_jitter_between_stamps_is_that_of_one_stamp_and_ignores_what_is_lost() -> None:
    generator = np.random.default_rng(3)
    stamps_ns = _record_times_ns(20_000) + generator.normal(0, 200_000, 20_000).astype(np.int64)
    assert interval_jitter_ns(stamps_ns) == pytest.approx(200_000, rel=0.03)
    lossy_ns = np.delete(stamps_ns, generator.choice(20_000, 1000, replace=False))
    assert interval_jitter_ns(lossy_ns) == pytest.approx(200_000, rel=0.15)
    assert interval_jitter_ns(stamps_ns[:2]) == 0
