"""When every topic delivered and how fast, on one time axis.

**Conventions.** As in `coverage`: time is the recorder's, rates are messages per second.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

from services.ingest.cdr import NS_PER_S
from services.ingest.quality.facts import Coverage
from services.ingest.quality.markup import Table, details, figure, legend, name, number, percent, section, table, text
from services.ingest.quality.plots import Frame, Line, time_plot
from services.ingest.quality.score import SENSOR_ROLES
from services.ingest.quality.strips import cover_strip, span_strip

MOST_LINES = 40
ROLE_COLOUR = {"lidar": "c0", "camera": "c1", "radar": "c2", "ins": "c3", "imu": "c6", "gnss": "c5", "odometry": "c4"}


def coverage_section(coverage: Sequence[Coverage], topics_total: int, duration_ns: int) -> str:
    return section("coverage", "Coverage of every topic", _coverage(coverage, topics_total, duration_ns))


def rates_section(coverage: Sequence[Coverage], duration_ns: int) -> str:
    steady = [topic for topic in coverage if topic.rates_hz and topic.role in SENSOR_ROLES][:MOST_LINES]
    return section("rates", "Rates over time", [_rates(steady, duration_ns)] if steady else [])


def _coverage(coverage: Sequence[Coverage], topics_total: int, duration_ns: int) -> Iterator[str]:
    if not coverage:
        return
    yield legend([("cover", "messages came in time"), ("gap", "gap"), ("loose", "keeps no period"), ("rail", "silent")])
    yield f'<ul class="rows">{"".join(_row(topic, duration_ns) for topic in coverage)}</ul>'
    yield f'<p class="soft">Every bar runs from 0 to {number(duration_ns / NS_PER_S)} s.</p>'
    if topics_total > len(coverage):
        yield f"<p>… and {topics_total - len(coverage)} topics more, most of them without messages.</p>"
    yield details("Coverage as a table", table(_table(coverage)))


def _row(topic: Coverage, duration_ns: int) -> str:
    span_ns = max(1, duration_ns)
    if topic.covered_ratio is None:
        bar, told = (
            span_strip(topic.first_ns / span_ns, topic.last_ns / span_ns),
            f"{topic.count} message{'' if topic.count == 1 else 's'}",
        )
    else:
        bar = cover_strip(topic.covered, [(start / span_ns, end / span_ns) for start, end in topic.gaps_ns])
        gaps = f" · {len(topic.gaps_ns)} gap{'s' if len(topic.gaps_ns) > 1 else ''}" if topic.gaps_ns else ""
        told = f"{number(topic.rate_hz)} Hz · {percent(topic.covered_ratio)}{gaps}"
    return f'<li><div class="what">{name(topic.topic)}<span>{text(topic.role)} · {told}</span></div>{bar}</li>'


def _table(coverage: Sequence[Coverage]) -> Table:
    rows = tuple(
        (
            name(topic.topic),
            text(topic.role),
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
    return Table("Messages, rate and coverage by topic", columns, rows, frozenset(range(2, 8)))


def _rates(steady: Sequence[Coverage], duration_ns: int) -> str:
    span_s = duration_ns / NS_PER_S
    lines = [Line(_middles(len(topic.rates_hz), span_s), _seen(topic), ROLE_COLOUR[topic.role]) for topic in steady]
    usual_hz = [topic.rate_hz or 1.0 for topic in steady]
    frame = Frame("rates", span_s, "messages per second", min(usual_hz) / 4, 2.5 * max(usual_hz), is_log=True)
    roles = [role for role in ROLE_COLOUR if any(topic.role == role for topic in steady)]
    key = legend([(ROLE_COLOUR[role], role) for role in roles])
    told = f"One line for each of {len(steady)} sensors; a level line is a sensor that keeps its pace."
    relative = [replace(line, values=_share(topic)) for line, topic in zip(lines, steady, strict=True)]
    of_usual = "The same against what is usual for each: a dip is loss, a peak a burst."
    rows = tuple(
        (name(topic.topic), number(topic.rate_hz, 2), number(min(topic.rates_hz), 2), number(max(topic.rates_hz), 2))
        for topic in steady
    )
    values = Table("Rates by topic, Hz", ("topic", "usual", "lowest", "highest"), rows, frozenset({1, 2, 3}))
    absolute = figure("Messages per second", time_plot(frame, lines), told, details("As a table", table(values)))
    share_plot = time_plot(Frame("relative-rates", span_s, "of the usual rate, %", 0.0, 200.0), relative)
    return f'{key}<div class="grid">{absolute}{figure("Share of the usual rate", share_plot, of_usual)}</div>'


def _share(topic: Coverage) -> tuple[float, ...]:
    """In percent, of at most twice the usual."""
    return tuple(min(200.0, 100.0 * rate_hz / (topic.rate_hz or 1.0)) for rate_hz in topic.rates_hz)


def _seen(topic: Coverage) -> tuple[float, ...]:
    """A logarithm has no zero: silence is drawn far below the frame, at a thousandth of what is usual."""
    least_hz = (topic.rate_hz or 1.0) / 1000
    return tuple(max(rate_hz, least_hz) for rate_hz in topic.rates_hz)


def _middles(bins: int, span_s: float) -> tuple[float, ...]:
    return tuple((place + 0.5) * span_s / bins for place in range(bins))
