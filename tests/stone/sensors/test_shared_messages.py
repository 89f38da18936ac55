"""Messages that two recordings hold, against what was put into them."""

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from stone.sensors.shared_messages import TopicMessages, repeated_rows, runs_of, shared_messages

PERIOD_NS = 100_000_000


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
