"""The section on clocks: the delay from stamp to recording of each sensor, its drift and its scatter.

**Conventions.** As in `stone_recordings.clocks.report`: None means unknown and shows as a dash.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from markupsafe import Markup

from stone_recordings.clocks.report import ClockReport, ImuLag, TopicClock
from stone_recordings.report.quality.coverage import ROLES
from stone_recordings.report.quality.markup import DrawnFigure, HtmlTable, name, number
from stone_recordings.report.quality.plots import offset_plot
from stone_recordings.report.quality.section_time import ROLE_COLOUR

MOST_ROWS = 40
NS_PER_MS = 1e6
TOLD = (
    "Each row is a sensor, by its number in the table: the dot is the median time from stamp to recording, "
    "the bar its scatter. A sensor on another clock is far from zero."
)


@dataclass(frozen=True)
class ClocksSection:
    """`figure` has its table; None without a measurable clock, `lag` is empty if no other gyro turned."""

    figure: DrawnFigure | None
    table: HtmlTable | None
    lag: ImuLag | None


def clocks_section(clocks: ClockReport) -> ClocksSection | None:
    """Return the section; None without a measurable clock."""
    known = [clock for clock in clocks.topics if clock.offset_ns is not None and clock.role in ROLE_COLOUR]
    stamped = sorted(known, key=lambda clock: ROLES.index(clock.role))[:MOST_ROWS]
    if not stamped:
        return ClocksSection(None, None, clocks.imu_lag) if clocks.imu_lag else None
    plot = offset_plot("offsets", [_row(clock) for clock in stamped])
    return ClocksSection(DrawnFigure("From stamp to recording", plot, TOLD), _table(stamped), clocks.imu_lag)


def _row(clock: TopicClock) -> tuple[float, float, str]:
    colour = ROLE_COLOUR.get(clock.role, "soft")
    return (clock.offset_ns or 0) / NS_PER_MS, (clock.jitter_ns or 0) / NS_PER_MS, colour


def _table(stamped: Sequence[TopicClock]) -> HtmlTable:
    rows = tuple(
        (
            f"{row}",
            name(clock.topic),
            clock.stamp_source,
            _ms(clock.offset_ns) + _constant(clock),
            number(clock.drift_ppm, 1),
            _jitter(clock),
            str(clock.steps_back),
        )
        for row, clock in enumerate(stamped, start=1)
    )
    columns = ("row", "topic", "stamped by", "offset, ms", "drift, ppm", "jitter, ms", "back")
    return HtmlTable("Offset, drift and jitter by topic", columns, rows, frozenset({0, 3, 4, 5, 6}))


def _constant(clock: TopicClock) -> Markup:
    return Markup('<br><span class="soft">= {}?</span>').format(clock.constant) if clock.constant else Markup()


def _jitter(clock: TopicClock) -> Markup:
    if clock.stated_jitter_ns is None:
        return number(None, 2)
    against = Markup('<br><span class="soft">{}</span>').format(clock.stated_against)
    return number(clock.stated_jitter_ns / NS_PER_MS, 2) + against


def _ms(value_ns: int | None) -> Markup:
    return number(None if value_ns is None else value_ns / NS_PER_MS, 3)
