"""Values as people read them."""

from datetime import UTC, datetime
from zoneinfo import ZoneInfo

import pytest
from hypothesis import given
from hypothesis import strategies as st

from web import words
from web.zones import written


@pytest.mark.parametrize(
    ("n_bytes", "said"),
    [
        (0, "0 B"), (999, "999 B"), (1000, "1.0 kB"), (99_499, "99.5 kB"), (123_456, "123 kB"), (999_600, "1.0 MB"),
        (2_500_000_000, "2.5 GB"), (None, "–"),
    ],
)  # fmt: skip
def test_sizes_are_written_as_disks_are_sold(n_bytes: int | None, said: str) -> None:
    assert words.size(n_bytes) == said


@given(st.integers(0, 10**16))
def test_a_size_is_never_more_than_four_digits(n_bytes: int) -> None:
    number, unit = words.size(n_bytes).split(" ")
    assert len(number.replace(".", "")) <= 4
    assert unit in words.UNITS


@pytest.mark.parametrize(
    ("seconds", "said"),
    [
        (0.04, "0.0 s"), (9.94, "9.9 s"), (59.6, "1 min"), (61, "1 min 1 s"), (3600, "1 h"), (3660, "1 h 1 min"),
        (90_061, "1 d 1 h"), (86_400 + 60, "1 d"), (None, "–"),
    ],
)  # fmt: skip
def test_a_span_is_its_two_largest_units(seconds: float | None, said: str) -> None:
    assert words.span(seconds) == said


@pytest.mark.parametrize(("ratio", "said"), [(0.2913, "29.1 %"), (1.0, "100.0 %"), (None, "–")])
def test_a_ratio_is_percent_and_what_is_undefined_a_dash(ratio: float | None, said: str) -> None:
    assert words.percent(ratio) == said


def test_a_time_is_written_in_the_readers_zone_and_says_when_it_is_utc() -> None:
    moment = datetime(2026, 11, 21, 20, 10, tzinfo=UTC)
    assert written(moment, UTC) == "2026-11-21 20:10 UTC"
    assert written(moment, ZoneInfo("Asia/Seoul")) == "2026-11-22 05:10"
    assert words.iso(moment) == "2026-11-21T20:10:00Z"
