"""The clock report of a recording as rows of dots with whiskers: offset, jitter and drift of every topic.

**Conventions.** Rows share one axis each: offsets are drawn on a signed logarithmic scale, since a clock that is whole
seconds off and one that is a millisecond late are both worth a look; drifts linearly. Offsets are record time − stamp,
whiskers ± 3 jitters and ± 5 standard errors. Read from the record that ingest wrote
(`stone_recordings/clocks/report.py`); what it does not say is None.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from web.plots.scales import Scale, duration_text, nice_ends, signed_log_ticks, tick_text, ticks
from web.plots.time_plot import WIDTH, PlotTick

LINEAR_BELOW_NS = 1e6
JITTERS, SIGMAS = 3.0, 5.0
DRIFT_LIMIT_PPM = 20.0
"""Beyond which a clock is reported (TIM-207, `stone_recordings/clocks/findings.py`)."""
LEAST_APART = 22.0
"""Per cent of the axis that a tick's words need."""
UNCLOCKED = ("tf", "tf_static", "camera_info", "other")


@dataclass(frozen=True)
class ClockWhisker:
    """A dot at `at` between `low` and `high`, in units of the plot's width."""

    low: float
    at: float
    high: float
    text: str
    is_bad: bool = False


@dataclass(frozen=True)
class ClockRow:
    """One topic; `jitter` is robust σ `against` sensor time or record time, `marks` what else was noticed."""

    topic: str
    role: str
    stamped_by: str
    offset: ClockWhisker | None
    drift: ClockWhisker | None
    jitter: str
    against: str
    marks: tuple[str, ...]


@dataclass(frozen=True)
class Clocks:
    """`zero_*` is where nothing is off; `steady` the part of the drift's axis that no finding is about."""

    rows: tuple[ClockRow, ...]
    offset_ticks: tuple[PlotTick, ...]
    drift_ticks: tuple[PlotTick, ...]
    zero_offset: float
    zero_drift: float
    steady: tuple[float, float]
    imu_lag: Mapping[str, Any] | None


def clocks_of(report: Mapping[str, Any]) -> Clocks | None:
    """None where no topic has a clock."""
    topics = [topic for topic in report.get("topics") or () if topic["role"] not in UNCLOCKED]
    if not topics:
        return None
    offsets, drifts = _offset_scale(topics), _drift_scale(topics)
    rows = tuple(_row(topic, offsets, drifts) for topic in topics)
    marked_ns = signed_log_ticks(offsets.low, offsets.high, LINEAR_BELOW_NS)
    step = ticks(drifts.low, drifts.high, 4)
    each = step[1] - step[0] if len(step) > 1 else 1.0
    return Clocks(
        rows,
        _apart(PlotTick(round(offsets.one(at) / WIDTH * 100, 2), duration_text(at) if at else "0") for at in marked_ns),
        tuple(PlotTick(round(drifts.one(at) / WIDTH * 100, 2), tick_text(at, each)) for at in step),
        round(offsets.one(0.0), 1),
        round(drifts.one(0.0), 1),
        (round(drifts.one(-DRIFT_LIMIT_PPM), 1), round(drifts.one(DRIFT_LIMIT_PPM), 1)),
        report.get("imu_lag"),
    )


def _row(topic: Mapping[str, Any], offsets: Scale, drifts: Scale) -> ClockRow:
    offset_ns, drift_ppm = topic.get("offset_ns"), topic.get("drift_ppm")
    own_jitter_ns = topic.get("own_jitter_ns")
    jitter_ns = topic.get("jitter_ns") if own_jitter_ns is None else own_jitter_ns
    against = "record time" if own_jitter_ns is None else "sensor time"
    return ClockRow(
        topic["topic"],
        topic["role"],
        topic["stamp_source"],
        None if offset_ns is None else _offset(topic, offsets),
        None if drift_ppm is None else _drift(topic, drifts),
        "" if jitter_ns is None else f"{jitter_ns / 1e6:.2f} ms",
        "" if jitter_ns is None else against,
        tuple(_marks(topic)),
    )


def _offset(topic: Mapping[str, Any], scale: Scale) -> ClockWhisker:
    middle, reach = float(topic["offset_ns"]), JITTERS * float(topic.get("jitter_ns") or 0)
    is_bad = bool(topic.get("constant"))
    return ClockWhisker(*_placed(scale, middle, reach), duration_text(middle), is_bad)


def _drift(topic: Mapping[str, Any], scale: Scale) -> ClockWhisker:
    middle, reach = float(topic["drift_ppm"]), SIGMAS * float(topic.get("drift_sigma_ppm") or 0)
    is_bad = abs(middle) > max(DRIFT_LIMIT_PPM, reach)
    return ClockWhisker(*_placed(scale, middle, reach), f"{tick_text(middle, 0.1)} ppm", is_bad)


def _placed(scale: Scale, middle: float, reach: float) -> tuple[float, float, float]:
    low, at, high = scale.at(np.array([middle - reach, middle, middle + reach])).tolist()
    return round(low, 1), round(at, 1), round(high, 1)


def _marks(topic: Mapping[str, Any]) -> Iterable[str]:
    if topic.get("constant"):
        yield topic["constant"]
    for key, word in (("gaps", "gap"), ("steps_back", "step back"), ("repeats", "repeated stamp")):
        if count := int(topic.get(key) or 0):
            yield f"{count} {word}" if count == 1 else f"{count} {word.replace('step', 'steps')}{_plural(word)}"
    if topic.get("own_offset_ns"):
        yield f"{duration_text(topic['own_offset_ns'])} after its own time"


def _plural(word: str) -> str:
    return "" if word.startswith("step") else "s"


def _apart(marks: Iterable[PlotTick]) -> tuple[PlotTick, ...]:
    """Those that can be read beside each other; zero always."""
    found = list(marks)
    zero = next((tick for tick in found if tick.text == "0"), None)
    kept = [zero] if zero else []
    for tick in sorted(found, key=lambda one: abs(one.at - (zero.at if zero else 0.0))):
        if all(abs(tick.at - other.at) >= LEAST_APART for other in kept):
            kept.append(tick)
    return tuple(sorted(kept, key=lambda one: one.at))


def _offset_scale(topics: Iterable[Mapping[str, Any]]) -> Scale:
    """Always holds zero, with room beside the outermost."""
    ends = [0.0]
    for topic in topics:
        if topic.get("offset_ns") is not None:
            reach = JITTERS * float(topic.get("jitter_ns") or 0)
            ends += [float(topic["offset_ns"]) - reach, float(topic["offset_ns"]) + reach]
    room = max(LINEAR_BELOW_NS, 0.3 * max(abs(end) for end in ends))
    low = min(ends) * 2 - room if min(ends) < 0 else -LINEAR_BELOW_NS
    return Scale(low, max(ends) * 2 + room, 0.0, WIDTH, LINEAR_BELOW_NS)


def _drift_scale(topics: Iterable[Mapping[str, Any]]) -> Scale:
    """Symmetric, and never narrower than what is steady."""
    reaches = [1.2 * DRIFT_LIMIT_PPM]
    reaches += [abs(float(topic["drift_ppm"])) * 1.1 for topic in topics if topic.get("drift_ppm") is not None]
    _, most = nice_ends(0.0, max(reaches), 3)
    return Scale(-most, most, 0.0, WIDTH)
