"""Counts add up like numbers, whoever counted them, and reach whoever asks: nothing twice, and the sum never falls."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from sqlalchemy import func, select

from services.runtime.orm import CounterRow
from services.runtime.platform import Platform
from services.runtime.telemetry.counter_rows import CounterWriter, counters_of_all_processes, fold
from services.runtime.telemetry.counters import FRAMES, JOB_SECONDS, Counts, ProcessCounters, less, summed
from testing.threads import at_once

counts = st.dictionaries(
    st.sampled_from(["stone_frames", "stone_store_bytes"]),
    st.dictionaries(st.sampled_from(["in", "out"]), st.integers(0, 2**40).map(float)),
)


def test_what_threads_count_at_once_is_all_counted() -> None:
    tallies = ProcessCounters()

    def count(_number: int) -> None:
        for _ in range(2000):
            tallies.add(FRAMES, ("scored",))

    at_once(4, count)
    assert tallies.counts() == {"stone_frames": {"scored": 8000.0}}


def test_a_histogram_puts_each_value_into_the_first_bucket_that_holds_it() -> None:
    tallies = ProcessCounters()
    for value in (0.0, 0.05, 0.06, 1800.0, 1801.0):
        tallies.observe(JOB_SECONDS, ("ingest.register", "succeeded"), value)
    (row,) = tallies.counts()["stone_job_seconds"].values()
    assert isinstance(row, list)
    *buckets, total = row
    assert (buckets[0], buckets[1], buckets[-2], buckets[-1]) == (2.0, 1.0, 1.0, 1.0)
    assert sum(buckets) == 5.0
    assert total == 0.05 + 0.06 + 1800.0 + 1801.0


@given(counts, counts, counts)
def test_sums_do_not_depend_on_who_is_added_first(one: Counts, two: Counts, three: Counts) -> None:
    assert summed((summed((one, two)), three)) == summed((one, summed((two, three))))
    assert summed((one, two)) == summed((two, one))


@given(counts, counts)
def test_what_was_counted_in_between_is_the_difference(before: Counts, more: Counts) -> None:
    between = less(summed((before, more)), before)
    assert {(name, key): value for name, of in between.items() for key, value in of.items() if value} == {
        (name, key): value for name, of in more.items() for key, value in of.items() if value
    }


def test_histograms_of_two_versions_are_not_mixed() -> None:
    assert summed(({"h": {"k": [1.0, 2.0, 3.0]}}, {"h": {"k": [1.0, 1.0]}})) == {"h": {"k": [1.0, 2.0, 3.0]}}
    assert summed(({"c": {"k": 1.0}}, {"c": {"k": [1.0]}})) == {"c": {"k": 1.0}}


def tell(platform: Platform, row: CounterWriter) -> None:
    with platform.database.transaction() as session:
        committed = row.tell(session)
    committed()


def scored(platform: Platform) -> float:
    with platform.database.reading() as session:
        value = counters_of_all_processes(session).get("stone_frames", {}).get("scored", 0.0)
    assert isinstance(value, float)
    return value


def rows(platform: Platform) -> int:
    with platform.database.reading() as session:
        return session.scalar(select(func.count()).select_from(CounterRow)) or 0


def test_processes_add_up_and_tell_only_what_grew(platform_on: Platform) -> None:
    counting = ProcessCounters(), ProcessCounters()
    telling = [CounterWriter(tallies) for tallies in counting]
    for amount, tallies in zip((3.0, 4.0), counting, strict=True):
        tallies.add(FRAMES, ("scored",), amount)
    for row in (*telling, *telling):
        tell(platform_on, row)
    assert (scored(platform_on), rows(platform_on)) == (7.0, 2)
    counting[0].add(FRAMES, ("scored",), 5.0)
    tell(platform_on, telling[0])
    assert scored(platform_on) == 12.0


def test_rows_that_fall_quiet_are_folded_and_the_sum_stays(platform_on: Platform) -> None:
    tallies = ProcessCounters()
    row = CounterWriter(tallies)
    for told in range(1, 4):
        tallies.add(FRAMES, ("scored",), 10.0)
        tell(platform_on, row)
        assert scored(platform_on) == 10.0 * told
        assert fold(platform_on, quiet_s=-1.0) == 1
        assert scored(platform_on) == 10.0 * told
    assert rows(platform_on) == 1
    assert fold(platform_on, quiet_s=-1.0) == 0


def test_a_row_that_was_told_of_a_moment_ago_is_not_folded(platform: Platform) -> None:
    tallies = ProcessCounters()
    tallies.add(FRAMES, ("scored",))
    tell(platform, CounterWriter(tallies))
    assert fold(platform) == 0


def test_what_was_rolled_back_is_told_again_and_once(platform: Platform) -> None:
    tallies = ProcessCounters()
    tallies.add(FRAMES, ("scored",), 2.0)
    row = CounterWriter(tallies)
    for _ in range(2):
        with pytest.raises(ZeroDivisionError), platform.database.transaction() as session:  # noqa: PT012
            row.tell(session)
            raise ZeroDivisionError
        assert scored(platform) == 0.0
    tell(platform, row)
    assert scored(platform) == 2.0


def test_a_commit_whose_word_was_lost_counts_once(platform_on: Platform) -> None:
    """The process does not hear that it was committed, and tells again."""
    tallies = ProcessCounters()
    tallies.add(FRAMES, ("scored",), 2.0)
    row = CounterWriter(tallies)
    for _ in range(2):
        with platform_on.database.transaction() as session:
            row.tell(session)
    tell(platform_on, row)
    assert (scored(platform_on), rows(platform_on)) == (2.0, 1)
