"""Samples, triggers and shared messages are told from stamps, whatever a few of them do."""

from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from stone.sensors.association import nearest_samples, trigger_phase_ns, triggered_samples, typical_period_ns
from stone.sensors.shared_messages import TopicMessages, repeated_rows, runs_of, shared_messages
from stone.sensors.triggers import LidarRotation, Triggers, look_of, triggers_of, wrapped_ns
from testing.refusals import refused_as

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


@settings(max_examples=150, deadline=None)
@given(small_stamps, small_stamps.map(sorted), st.integers(0, 20))
def test_nearest_is_the_nearest_of_all_pairs(queries, samples, tolerance):
    found = nearest_samples(stamps(queries), stamps(samples), tolerance)
    oracle = [nearest_slowly(q, samples, tolerance) for q in queries]
    assert found.index.dtype == found.dt_ns.dtype == np.int64
    assert list(zip(found.index.tolist(), found.dt_ns.tolist(), strict=True)) == oracle


def test_stamps_that_go_back_are_refused():
    with refused_as("unsorted_stamps"):
        nearest_samples(stamps([0]), stamps([0, 5, 2]), 7)
    with refused_as("unsorted_stamps"):
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


LATE_NS = 5_000_000
unhurried = settings(deadline=None, max_examples=50)
Stamps = NDArray[np.int64]
# Six cameras a sixth of a turn apart, as the LiDAR passes them.
RING_NS = np.array([4, 20, 37, 54, 70, 87], np.int64) * 1_000_000


def _sweep(direction: int, start_rad: float, packets: int, columns: int) -> tuple[NDArray[np.float64], Stamps]:
    """Points of an even turn; the columns of one packet share the time of its first."""
    count = packets * columns
    azimuth = start_rad + direction * 2 * np.pi * np.arange(count) / count
    reach = np.random.default_rng(0).uniform(2, 60, count)
    times_ns = np.repeat(np.arange(packets, dtype=np.int64) * PERIOD_NS // packets, columns)
    return np.stack([reach * np.cos(azimuth), reach * np.sin(azimuth), np.zeros(count)], axis=1), times_ns


@unhurried
@given(
    direction=st.sampled_from([1, -1]),
    start_rad=st.floats(-3.1, 3.1),
    shape=st.sampled_from([(1800, 1), (100, 9), (20, 18), (3600, 2)]),
    azimuth_rad=st.floats(-3.1, 3.1),
)
def test_it_looks_along_a_bearing_when_it_turned_so_far(
    direction: int, start_rad: float, shape: tuple[int, int], azimuth_rad: float
) -> None:
    """Within a fiftieth of the 2 ms that count, however many columns share a time."""
    look = look_of(*_sweep(direction, start_rad, *shape), PERIOD_NS)
    assert look is not None
    assert look.direction == direction
    expected_ns = round((direction * (azimuth_rad - start_rad)) % (2 * np.pi) / (2 * np.pi) * PERIOD_NS)
    assert abs(int(wrapped_ns(np.array([look.time_ns(azimuth_rad) - expected_ns]), PERIOD_NS)[0])) < 40_000


@unhurried
@given(shift_ns=st.integers(-PERIOD_NS, PERIOD_NS))
def test_a_later_stamp_makes_it_look_earlier_by_as_much(shift_ns: int) -> None:
    points, times_ns = _sweep(-1, 0.7, 1800, 1)
    here, there = look_of(points, times_ns, PERIOD_NS), look_of(points, times_ns - shift_ns, PERIOD_NS)
    assert here is not None
    assert there is not None
    moved_ns = np.array([there.time_ns(1.0) - here.time_ns(1.0) + shift_ns])
    assert abs(int(wrapped_ns(moved_ns, PERIOD_NS)[0])) < 1000


def test_points_without_an_even_turn_look_nowhere() -> None:
    points, times_ns = _sweep(1, 0.0, 1800, 1)
    shuffled = np.random.default_rng(0).permutation(times_ns)
    assert look_of(points, shuffled, PERIOD_NS) is None
    assert look_of(points * 1e-3, times_ns, PERIOD_NS) is None
    assert look_of(points[:0], times_ns[:0], PERIOD_NS) is None
    assert look_of(points, times_ns, 0) is None


def test_a_look_stays_within_the_period() -> None:
    look = LidarRotation(1, 0.0, PERIOD_NS)
    assert look.time_ns(0.0) == 0
    assert look.time_ns(-1e-12) == 0
    assert look.time_ns(np.pi) == PERIOD_NS // 2


def _triggers(fired_ns: Stamps, looks_ns: Stamps = RING_NS) -> Triggers:
    triggers = triggers_of(fired_ns, looks_ns, PERIOD_NS)
    assert triggers is not None
    return triggers


@unhurried
@given(noise=st.lists(st.integers(-900_000, 900_000), min_size=6, max_size=6))
def test_cameras_that_follow_are_neither_late_nor_swapped(noise: list[int]) -> None:
    triggers = _triggers(RING_NS + np.array(noise))
    assert triggers.looks_as.tolist() == [0, 1, 2, 3, 4, 5]
    assert abs(triggers.shared_ns) < 1_000_000
    assert np.abs(triggers.late_ns).max() < 2_000_000


@unhurried
@given(
    camera=st.integers(0, 5), late_ns=st.one_of(st.integers(2_500_000, 14_000_000), st.integers(-9 * 10**6, -2_500_000))
)
def test_the_one_that_is_late_is_named_with_how_late(camera: int, late_ns: int) -> None:
    fired_ns = RING_NS.copy()
    fired_ns[camera] += late_ns
    triggers = _triggers(fired_ns % PERIOD_NS)
    assert triggers.late_ns.tolist() == [late_ns if index == camera else 0 for index in range(6)]
    assert triggers.looks_as.tolist() == [0, 1, 2, 3, 4, 5]
    assert triggers.shared_ns == 0


@unhurried
@given(pair=st.permutations(range(6)), size=st.sampled_from([2, 3]), delay_ns=st.integers(-(10**6), 10**6))
def test_swapped_cameras_are_named_with_whose_place_they_have(pair: list[int], size: int, delay_ns: int) -> None:
    fired_ns, expected = RING_NS.copy(), list(range(6))
    swapped = pair[:size]
    for camera, place in zip(swapped, swapped[1:] + swapped[:1], strict=True):
        fired_ns[camera], expected[camera] = RING_NS[place], place
    triggers = _triggers(fired_ns + delay_ns)
    assert triggers.looks_as.tolist() == expected
    assert not triggers.late_ns.any()


@unhurried
@given(shift_ns=st.integers(-40_000_000, 40_000_000))
def test_what_all_cameras_share_is_told_once(shift_ns: int) -> None:
    fired_ns = RING_NS + shift_ns
    fired_ns[2] += LATE_NS
    triggers = _triggers(fired_ns)
    assert triggers.shared_ns == shift_ns
    assert triggers.late_ns.tolist() == [0, 0, LATE_NS, 0, 0, 0]


@unhurried
@given(order=st.permutations(range(6)))
def test_the_order_of_the_cameras_does_not_matter(order: list[int]) -> None:
    fired_ns = RING_NS[[0, 2, 1, 3, 4, 5]] + np.array([0, 0, 0, 0, LATE_NS, 0])
    here, there = _triggers(fired_ns), _triggers(fired_ns[order], RING_NS[order])
    assert there.late_ns.tolist() == here.late_ns[order].tolist()
    assert [order[index] for index in there.looks_as.tolist()] == here.looks_as[order].tolist()


def test_cameras_that_all_fire_at_once_do_not_follow() -> None:
    for instant_ns in range(0, PERIOD_NS, 3_000_000):
        assert triggers_of(np.full(6, instant_ns, np.int64), RING_NS, PERIOD_NS) is None


def test_cameras_that_run_freely_do_not_follow() -> None:
    """But for the few that agree by chance."""
    generator = np.random.default_rng(1)
    told = [triggers_of(generator.integers(0, PERIOD_NS, 6), RING_NS, PERIOD_NS) for _trial in range(500)]
    assert sum(triggers is not None for triggers in told) <= 15


def test_one_camera_alone_tells_nothing_and_two_may_be_swapped() -> None:
    assert triggers_of(RING_NS[:1] + LATE_NS, RING_NS[:1], PERIOD_NS) is None
    assert _triggers(RING_NS[[1, 0]], RING_NS[:2]).looks_as.tolist() == [1, 0]
    assert _triggers(RING_NS[:2] + np.array([0, LATE_NS]), RING_NS[:2]).late_ns.tolist() == [0, LATE_NS]


@given(st.integers(-(10**12), 10**12), st.integers(2, 10**9))
def test_a_wrapped_difference_is_the_least_one(difference_ns: int, period_ns: int) -> None:
    wrapped = int(wrapped_ns(np.array([difference_ns]), period_ns)[0])
    assert (difference_ns - wrapped) % period_ns == 0
    assert abs(wrapped) == min(difference_ns % period_ns, -difference_ns % period_ns)


def topic(first: int, last: int, stamped: int = 0, logged: int = 0, *, has_stamps: bool = True) -> TopicMessages:
    """Messages number `first` to `last` of a sensor; clocks so far ahead."""
    numbers = np.arange(first, last, dtype=np.int64)
    stamps = (numbers + 1) * PERIOD_NS + stamped if has_stamps else np.zeros(len(numbers), np.int64)
    return TopicMessages((numbers + 1) * PERIOD_NS + 5_000_000 + logged, stamps, (numbers + 77).astype(np.uint64))


@given(st.integers(-(10**12), 10**12), st.integers(0, 20), st.integers(-(10**9), 10**9))
def test_stamps_that_somebody_moved_tell_exactly(moved_ns: int, begin: int, logged_ns: int) -> None:
    found = shared_messages(topic(0, 30), topic(begin, 40, stamped=moved_ns, logged=logged_ns))
    assert found is not None
    assert found.stamp_offset_ns == -moved_ns
    assert found.log_offset_ns == -logged_ns
    assert found.count == 30 - begin


def test_two_recordings_without_a_message_in_common_tell_nothing() -> None:
    assert shared_messages(topic(0, 30), topic(30, 60)) is None
    assert shared_messages(topic(0, 30), topic(28, 60)) is None


def test_what_repeats_itself_tells_nothing() -> None:
    """The intrinsics of a camera are the same at any time."""
    same = TopicMessages(np.arange(50) * PERIOD_NS, np.arange(50) * PERIOD_NS, np.full(50, 7, np.uint64))
    assert shared_messages(same, same) is None


def test_the_scatter_of_the_log_is_told() -> None:
    late = np.random.default_rng(1).normal(0, 2e6, 200).astype(np.int64)
    one, two = topic(0, 200), topic(0, 200)
    found = shared_messages(one, TopicMessages(two.log_times_ns + 80_000_000 + late, two.stamps_ns, two.digests))
    assert found is not None
    assert found.stamp_offset_ns == 0
    assert abs(found.log_offset_ns + 80_000_000) < 500_000
    assert 1_500_000 < found.spread_ns < 2_500_000


@given(st.integers(0, 30), st.integers(0, 30), st.integers(1, 30))
def test_the_messages_that_both_hold_are_found(begin: int, other: int, length: int) -> None:
    own = topic(other, other + length)
    found = repeated_rows(topic(begin, begin + 15), own, 0)
    shared = set(range(begin, begin + 15)) & set(range(other, other + length))
    assert found.tolist() == [number - other for number in sorted(shared)]


def test_equal_content_at_another_time_is_another_message() -> None:
    assert len(repeated_rows(topic(0, 9), topic(0, 9, stamped=1), 10**9)) == 0
    unstamped = topic(0, 9, has_stamps=False), topic(0, 9, logged=2_000_000, has_stamps=False)
    assert len(repeated_rows(*unstamped, 1_000_000)) == 0
    assert len(repeated_rows(*unstamped, 2_000_000)) == 9


@given(st.sets(st.integers(0, 60)))
def test_runs_are_the_rows(rows: set[int]) -> None:
    runs = runs_of(np.array(sorted(rows), np.int64))
    assert {row for start, stop in runs for row in range(start, stop)} == rows
    assert all(one[1] < two[0] for one, two in pairwise(runs))


@given(
    st.lists(st.tuples(st.integers(0, 3), st.integers(0, 40)), max_size=12),
    st.lists(st.tuples(st.integers(0, 3), st.integers(0, 40)), max_size=12),
    st.integers(0, 9),
)
def test_messages_without_a_stamp_are_found_as_by_looking_at_each_pair(
    one: list[tuple[int, int]], two: list[tuple[int, int]], tolerance: int
) -> None:
    first, second = (
        TopicMessages(
            np.array([time for _, time in messages], np.int64),
            np.zeros(len(messages), np.int64),
            np.array([digest for digest, _ in messages], np.uint64),
        )
        for messages in (one, two)
    )
    slowly = [
        row
        for row, (digest, time) in enumerate(two)
        if any(digest == other and abs(time - at) <= tolerance for other, at in one)
    ]
    assert repeated_rows(first, second, tolerance).tolist() == slowly
