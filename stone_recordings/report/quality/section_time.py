"""The deliveries and rates of every topic, on one time axis.

**Conventions.** As in `coverage`: time is the recorder's, rates are messages per second.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from markupsafe import Markup

from stone_recordings.messages.types.cdr import NS_PER_S
from stone_recordings.report.quality.facts import Coverage
from stone_recordings.report.quality.markup import DrawnFigure, HtmlTable, name, number, percent, text
from stone_recordings.report.quality.plots import Frame, PlotLine, StripBar, cover_strip, span_strip, time_plot
from stone_recordings.report.quality.score import SENSOR_ROLES

MOST_LINES = 40
ROLE_COLOUR = {"lidar": "c0", "camera": "c1", "radar": "c2", "ins": "c3", "imu": "c6", "gnss": "c5", "odometry": "c4"}


@dataclass(frozen=True)
class CoverageRow:
    """A topic, its caption, and its deliveries."""

    topic: str
    told: Markup
    bars: tuple[StripBar, ...]


@dataclass(frozen=True)
class CoverageSection:
    """`left_out` are topics without a row."""

    rows: tuple[CoverageRow, ...]
    left_out: int
    table: HtmlTable


@dataclass(frozen=True)
class RatesSection:
    """The rates of sensors, and the same relative to each one's usual rate; `legend` is by role."""

    legend: tuple[tuple[str, str], ...]
    figures: tuple[DrawnFigure, ...]


def coverage_section(coverage: Sequence[Coverage], topics_total: int, duration_ns: int) -> CoverageSection | None:
    """Return the section; None for an empty recording."""
    if not coverage:
        return None
    rows = tuple(_row(topic, max(1, duration_ns)) for topic in coverage)
    return CoverageSection(rows, max(0, topics_total - len(coverage)), _table(coverage))


def rates_section(coverage: Sequence[Coverage], duration_ns: int) -> RatesSection | None:
    """Return the section; None if no sensor is periodic."""
    steady = [topic for topic in coverage if topic.rates_hz and topic.role in SENSOR_ROLES][:MOST_LINES]
    return _rates(steady, duration_ns / NS_PER_S) if steady else None


def _row(topic: Coverage, span_ns: int) -> CoverageRow:
    if topic.covered_ratio is None:
        bars = span_strip(topic.first_ns / span_ns, topic.last_ns / span_ns)
        caption = text(f"{topic.count} message{'' if topic.count == 1 else 's'}")
    else:
        bars = cover_strip(topic.covered, [(start / span_ns, end / span_ns) for start, end in topic.gaps_ns])
        gaps = f" · {len(topic.gaps_ns)} gap{'s' if len(topic.gaps_ns) > 1 else ''}" if topic.gaps_ns else ""
        caption = Markup("{} Hz · {}{}").format(number(topic.rate_hz), percent(topic.covered_ratio), gaps)
    return CoverageRow(topic.topic, Markup("{} · {}").format(topic.role, caption), bars)


def _table(coverage: Sequence[Coverage]) -> HtmlTable:
    rows = tuple(
        (
            name(topic.topic),
            topic.role,
            str(topic.count),
            number(topic.rate_hz, 2),
            number(topic.first_ns / NS_PER_S, 2),
            number(topic.last_ns / NS_PER_S, 2),
            percent(topic.covered_ratio, 2),
            str(len(topic.gaps_ns)),
        )
        for topic in coverage
    )
    columns = ("topic", "role", "messages", "Hz", "first, s", "last, s", "covered", "gaps")
    return HtmlTable("Messages, rate and coverage by topic", columns, rows, frozenset(range(2, 8)))


def _rates(steady: Sequence[Coverage], span_s: float) -> RatesSection:
    lines = [PlotLine(_middles(len(topic.rates_hz), span_s), _seen(topic), ROLE_COLOUR[topic.role]) for topic in steady]
    relative = [replace(line, values=_share(topic)) for line, topic in zip(lines, steady, strict=True)]
    usual_hz = [topic.rate_hz or 1.0 for topic in steady]
    frame = Frame("rates", span_s, "messages per second", min(usual_hz) / 4, 2.5 * max(usual_hz), is_log=True)
    caption = f"One line for each of {len(steady)} sensors; a flat line is a constant rate."
    absolute = DrawnFigure("Messages per second", time_plot(frame, lines), caption, table=_rate_table(steady))
    share_plot = time_plot(Frame("relative-rates", span_s, "of the usual rate, %", 0.0, 200.0), relative)
    of_usual = "The same relative to each sensor's usual rate: a dip is loss, a peak a burst."
    legend = tuple((ROLE_COLOUR[role], role) for role in ROLE_COLOUR if any(topic.role == role for topic in steady))
    return RatesSection(legend, (absolute, DrawnFigure("Share of the usual rate", share_plot, of_usual)))


def _rate_table(steady: Sequence[Coverage]) -> HtmlTable:
    rows = tuple(
        (name(topic.topic), number(topic.rate_hz, 2), number(min(topic.rates_hz), 2), number(max(topic.rates_hz), 2))
        for topic in steady
    )
    return HtmlTable("Rates by topic, Hz", ("topic", "usual", "lowest", "highest"), rows, frozenset({1, 2, 3}))


def _share(topic: Coverage) -> tuple[float, ...]:
    """Return the rates in percent, at most twice the usual."""
    return tuple(min(200.0, 100.0 * rate_hz / (topic.rate_hz or 1.0)) for rate_hz in topic.rates_hz)


def _seen(topic: Coverage) -> tuple[float, ...]:
    """Return the rates for a logarithmic axis: silence is drawn far below the frame, at a thousandth of the usual
    rate.
    """
    least_hz = (topic.rate_hz or 1.0) / 1000
    return tuple(max(rate_hz, least_hz) for rate_hz in topic.rates_hz)


def _middles(bins: int, span_s: float) -> tuple[float, ...]:
    return tuple((index + 0.5) * span_s / bins for index in range(bins))
