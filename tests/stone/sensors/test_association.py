"""Association against a loop over all pairs, and what it refuses."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stone.sensors.association import (
    UnsortedStampsError,
    nearest_samples,
    trigger_phase_ns,
    triggered_samples,
    typical_period_ns,
)

TODAY_NS = 1_760_000_000_123_456_789
PERIOD_NS = 100_000_000
small_stamps = st.lists(st.integers(0, 60), max_size=12)


def stamps(values):
    return np.array(values, dtype=np.int64) + TODAY_NS


def nearest_slowly(query, samples, tolerance):
    """The first of the nearest, by looking at all of them."""
    best = min(range(len(samples)), key=lambda i: (abs(samples[i] - query), samples[i], i), default=-1)
    if best < 0 or abs(samples[best] - query) > tolerance:
        return -1, 0
    return best, samples[best] - query


@settings(max_examples=300, deadline=None)
@given(small_stamps, small_stamps.map(sorted), st.integers(0, 20))
def test_nearest_is_the_nearest_of_all_pairs(queries, samples, tolerance):
    found = nearest_samples(stamps(queries), stamps(samples), tolerance)
    oracle = [nearest_slowly(q, samples, tolerance) for q in queries]
    assert found.index.dtype == found.dt_ns.dtype == np.int64
    assert list(zip(found.index.tolist(), found.dt_ns.tolist(), strict=True)) == oracle


def test_a_tie_goes_to_the_earlier_sample():
    found = nearest_samples(stamps([10]), stamps([5, 15]), 5)
    assert (found.index[0], found.dt_ns[0]) == (0, -5)


def test_one_nanosecond_decides_at_todays_date():
    assert nearest_samples(stamps([10]), stamps([4, 15]), 100).index[0] == 1


def test_the_tolerance_itself_is_near_enough_and_one_more_is_not():
    assert nearest_samples(stamps([0]), stamps([7]), 7).index[0] == 0
    assert nearest_samples(stamps([0]), stamps([8]), 7).index[0] == -1


def test_stamps_that_go_back_are_refused():
    with pytest.raises(UnsortedStampsError, match=r"stamps_ns\[2\] steps by -3 ns"):
        nearest_samples(stamps([0]), stamps([0, 5, 2]), 7)
    with pytest.raises(UnsortedStampsError, match=r"frames_ns\[1\]"):
        trigger_phase_ns(stamps([5, 0]), stamps([0]), PERIOD_NS)


def test_the_period_is_the_median_step():
    assert typical_period_ns(stamps([0, 10, 20, 500])) == 10
    assert typical_period_ns(stamps([3])) == 0


@settings(max_examples=60, deadline=None)
@given(st.integers(0, PERIOD_NS - 3_000_000), st.integers(0, 2**32))
def test_a_camera_finds_the_frame_that_triggered_it(phase_ns, seed):
    rng = np.random.default_rng(seed)
    frames_ns = TODAY_NS + np.arange(30) * PERIOD_NS
    images_ns = frames_ns + phase_ns + rng.integers(-500_000, 500_001, 30)
    found, learnt_ns = triggered_samples(frames_ns, images_ns, PERIOD_NS)
    assert abs(learnt_ns - phase_ns) < 500_001
    np.testing.assert_array_equal(found.index, np.arange(30))
    np.testing.assert_array_equal(found.dt_ns, images_ns - frames_ns)


def test_a_missing_trigger_leaves_its_frame_without_an_image():
    frames_ns = TODAY_NS + np.arange(10) * PERIOD_NS
    images_ns = np.delete(frames_ns + 60_000_000, 4)
    found, learnt_ns = triggered_samples(frames_ns, images_ns, PERIOD_NS)
    assert learnt_ns == 60_000_000
    assert found.index.tolist() == [0, 1, 2, 3, -1, 4, 5, 6, 7, 8]
    assert found.dt_ns[4] == 0


def test_no_image_means_no_phase_and_no_association():
    found, learnt_ns = triggered_samples(stamps([0, 100]), stamps([]), 100)
    assert learnt_ns == 0
    assert found.index.tolist() == [-1, -1]
    assert nearest_samples(stamps([]), stamps([1]), 1).index.size == 0
