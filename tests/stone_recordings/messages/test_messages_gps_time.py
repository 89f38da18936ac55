"""GPS time becomes UTC with the leap seconds of its day."""

from datetime import UTC, datetime

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stone_recordings.messages.gps_time import leap_seconds, unix_ns

WEEK_MS = 604_800_000


def _utc(week: int, milliseconds: int) -> datetime:
    return datetime.fromtimestamp(unix_ns(np.array([week]), np.array([milliseconds]))[0] / 1e9, UTC)


def test_gps_time_begins_in_1980_level_with_utc() -> None:
    assert _utc(0, 0) == datetime(1980, 1, 6, tzinfo=UTC)


@pytest.mark.parametrize(
    ("day", "seconds"),
    [((2016, 12, 31), 17), ((2017, 1, 2), 18), ((2026, 7, 1), 18), ((1999, 6, 1), 13), ((1981, 6, 30), 0)],
)
def test_the_offset_is_that_of_the_day(day: tuple[int, int, int], seconds: int) -> None:
    noon_s = int(datetime(*day, 12, tzinfo=UTC).timestamp())
    assert leap_seconds(np.array([noon_s + seconds])).tolist() == [seconds]


def test_a_leap_second_begins_exactly_at_midnight() -> None:
    """2017-01-01T00:00:00 UTC is GPS week 1930, second 18: the second before it is 23:59:60."""
    assert _utc(1930, 18_000) == datetime(2017, 1, 1, tzinfo=UTC)
    assert _utc(1930, 16_000) == datetime(2016, 12, 31, 23, 59, 59, tzinfo=UTC)


@given(week=st.integers(1931, 4000), milliseconds=st.integers(0, WEEK_MS - 1))
def test_since_2017_it_is_the_plain_formula(week: int, milliseconds: int) -> None:
    expected = (315_964_800 + week * 604_800 - 18) * 10**9 + milliseconds * 10**6
    assert unix_ns(np.array([week], np.uint16), np.array([milliseconds], np.uint32)).tolist() == [expected]


@given(week=st.integers(0, 4000), milliseconds=st.integers(0, WEEK_MS - 2000))
def test_time_never_runs_backwards_except_within_a_leap_second(week: int, milliseconds: int) -> None:
    now, later = unix_ns(np.array([week, week]), np.array([milliseconds, milliseconds + 1001]))
    assert later > now
