"""What processes counted reaches whoever asks, on both databases: nothing twice, and the sum never falls."""

import pytest
from sqlalchemy import func, select

from services.runtime.orm import CounterRow
from services.runtime.platform import Platform
from services.runtime.telemetry.counter_rows import CounterWriter, counters_of_all_processes, fold
from services.runtime.telemetry.counters import ProcessCounters
from services.runtime.telemetry.metric_names import FRAMES


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


def test_a_row_that_was_told_of_a_moment_ago_is_not_folded(platform_on: Platform) -> None:
    tallies = ProcessCounters()
    tallies.add(FRAMES, ("scored",))
    tell(platform_on, CounterWriter(tallies))
    assert fold(platform_on) == 0


def test_what_was_rolled_back_is_told_again_and_once(platform_on: Platform) -> None:
    tallies = ProcessCounters()
    tallies.add(FRAMES, ("scored",), 2.0)
    row = CounterWriter(tallies)
    for _ in range(2):
        with pytest.raises(ZeroDivisionError), platform_on.database.transaction() as session:  # noqa: PT012
            row.tell(session)
            raise ZeroDivisionError
        assert scored(platform_on) == 0.0
    tell(platform_on, row)
    assert scored(platform_on) == 2.0


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
