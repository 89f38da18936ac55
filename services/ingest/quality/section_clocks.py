"""What the clocks say: how far stamps are from the recording of their messages, how much they drift and scatter.

**Conventions.** As in `services.ingest.clocks.report`: None is "cannot be told" and shows as a dash.
"""

from collections.abc import Iterator, Sequence

from services.ingest.clocks.report import ClockReport, ImuLag, TopicClock
from services.ingest.quality.coverage import ROLES
from services.ingest.quality.markup import Table, figure, name, number, section, table, text
from services.ingest.quality.plots import offset_plot
from services.ingest.quality.section_time import ROLE_COLOUR

MOST_ROWS = 40
NS_PER_MS = 1e6


def clocks_section(clocks: ClockReport) -> str:
    return section("clocks", "Clocks", _clocks(clocks))


def _clocks(clocks: ClockReport) -> Iterator[str]:
    known = [clock for clock in clocks.topics if clock.offset_ns is not None and clock.role in ROLE_COLOUR]
    if stamped := sorted(known, key=lambda clock: ROLES.index(clock.role))[:MOST_ROWS]:
        told = (
            "Each row is a sensor, by its number in the table: the dot is the median time from stamp to recording, "
            "the bar its scatter. Another clock stands far from zero."
        )
        plot = figure("From stamp to recording", offset_plot("offsets", [_row(clock) for clock in stamped]), told)
        yield f'<div class="grid wide">{plot}{table(_table(stamped))}</div>'
    if clocks.imu_lag is not None:
        yield f"<p>{_lag(clocks.imu_lag)}</p>"


def _row(clock: TopicClock) -> tuple[float, float, str]:
    colour = ROLE_COLOUR.get(clock.role, "soft")
    return (clock.offset_ns or 0) / NS_PER_MS, (clock.jitter_ns or 0) / NS_PER_MS, colour


def _table(stamped: Sequence[TopicClock]) -> Table:
    rows = tuple(
        (
            f"{place}",
            name(clock.topic),
            text(clock.stamp_source),
            f"{_ms(clock.offset_ns)}{_constant(clock)}",
            number(clock.drift_ppm, 1),
            _ms(clock.jitter_ns),
            str(clock.steps_back),
        )
        for place, clock in enumerate(stamped, start=1)
    )
    columns = ("row", "topic", "stamped by", "offset, ms", "drift, ppm", "jitter, ms", "back")
    return Table("Offset, drift and jitter by topic", columns, rows, frozenset({0, 3, 4, 5, 6}))


def _constant(clock: TopicClock) -> str:
    return f'<br><span class="soft">= {text(clock.constant)}?</span>' if clock.constant else ""


def _lag(lag: ImuLag) -> str:
    return (
        f"The gyro {name(lag.topic)} is {number(lag.lag_ns / NS_PER_MS, 2)} ± {number(lag.sigma_ns / NS_PER_MS, 2)} ms "
        f"later than {name(lag.reference)} for the same turn (correlation {lag.correlation:.3f})."
    )


def _ms(value_ns: int | None) -> str:
    return number(None if value_ns is None else value_ns / NS_PER_MS, 3)
