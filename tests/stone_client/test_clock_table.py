"""The clock report as a table: what is unknown is a dash, and names of topics are text, never markup."""

from io import StringIO
from typing import Any

from rich.console import Console

from stone_client.tables import clock_table
from stone_recordings.clocks.report import ClockReport, ImuLag, TopicClock


def _shown(report: ClockReport) -> str:
    console = Console(width=120, file=StringIO())
    with console.capture() as shown:
        console.print(clock_table(report.as_record()))
    return shown.get()


def _clock(topic: str, **facts: Any) -> TopicClock:
    return TopicClock(topic, facts.pop("role", "imu"), 10, 10.0, facts.pop("stamp_source", "sensor"), **facts)


def test_numbers_have_their_units_and_constants_their_names() -> None:
    ahead = _clock(
        "/a", offset_ns=-36_892_000_000, drift_ppm=-4.04, jitter_ns=150_000, constant="TAI-UTC", steps_back=3
    )
    late = _clock("/b", offset_ns=12_340_000, own_offset_ns=9_700_000, own_jitter_ns=7_680_000)
    shown = _shown(ClockReport((ahead, late)))
    assert "-36.892 s (TAI-UTC)" in shown
    assert "-4.0" in shown
    assert "12.3 ms" in shown
    assert "7.68" in shown
    assert "9.7" in shown


def test_what_cannot_be_told_is_a_dash() -> None:
    (row,) = [
        line for line in _shown(ClockReport((_clock("/tf", stamp_source="recorder"),))).splitlines() if "/tf" in line
    ]
    assert row.split() == ["/tf", "recorder", "–", "–", "–", "–", "0", "0"]


def test_the_lag_of_the_imu_is_in_the_title_with_its_error() -> None:
    shown = _shown(ClockReport((), ImuLag("/imu", "/ins", 12_100_000, 240_000, 0.998)))
    assert "gyro of /imu late by +12.1 ± 0.2 ms against /ins" in " ".join(shown.split())


def test_a_camera_info_is_left_out() -> None:
    shown = _shown(ClockReport((_clock("/image", role="camera"), _clock("/info", role="camera_info"))))
    assert "/image" in shown
    assert "/info" not in shown


def test_names_of_topics_are_no_markup() -> None:
    shown = _shown(ClockReport((_clock("/[bold]x[/bold]"),), ImuLag("/[red]i", "/[/red]r", 0, 0, 1.0)))
    assert "/[bold]x[/bold]" in shown
    assert "/[red]i" in shown
