"""Figures of a recording's inspection and quality report: delivery times, rates and quality of sensors.

**Conventions.** Read from the records that ingest wrote (`stone_recordings/report/inspection.py`, `quality/report.py`);
values missing in an older record are left out. Sensors come first, in the order of the report. Topics without clock
data (tf, camera_info, other) are separate. A spark is `SPARK` units in size, from the lowest to the highest value.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

import numpy as np

from web.plots.paths import line
from web.plots.scales import Scale, duration_text, nice_ends, signed_log_ticks, tick_text, ticks
from web.plots.time_plot import WIDTH, Plot, PlotDescription, PlotSeries, PlotSpan, PlotTick, marked, time_plot

# The clock report of a recording as rows of dots with whiskers: offset, jitter and drift of every topic.
# **Conventions.** Rows share one axis each. Offsets use a signed logarithmic scale, so that whole seconds and single
# milliseconds are both visible; drifts a linear one. Offsets are record time − stamp, whiskers ± 3 jitters and ± 5
# standard errors. Read from the record that ingest wrote (`stone_recordings/clocks/report.py`); missing values are
# None.


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
    """The clocks; `zero_*` are the positions of zero; `steady` is the part of the drift's axis without findings."""

    rows: tuple[ClockRow, ...]
    offset_ticks: tuple[PlotTick, ...]
    drift_ticks: tuple[PlotTick, ...]
    zero_offset: float
    zero_drift: float
    steady: tuple[float, float]
    imu_lag: Mapping[str, Any] | None


def clocks_of(report: Mapping[str, Any]) -> Clocks | None:
    """Return the clocks, or None if no topic has a clock."""
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
    """Return the ticks that do not overlap, always including zero."""
    ticks = list(marks)
    zero = next((tick for tick in ticks if tick.text == "0"), None)
    kept = [zero] if zero else []
    for tick in sorted(ticks, key=lambda one: abs(one.at - (zero.at if zero else 0.0))):
        if all(abs(tick.at - other.at) >= LEAST_APART for other in kept):
            kept.append(tick)
    return tuple(sorted(kept, key=lambda one: one.at))


def _offset_scale(topics: Iterable[Mapping[str, Any]]) -> Scale:
    """Return a scale that always contains zero, with a margin at the outermost offset."""
    ends = [0.0]
    for topic in topics:
        if topic.get("offset_ns") is not None:
            reach = JITTERS * float(topic.get("jitter_ns") or 0)
            ends += [float(topic["offset_ns"]) - reach, float(topic["offset_ns"]) + reach]
    room = max(LINEAR_BELOW_NS, 0.3 * max(abs(end) for end in ends))
    low = min(ends) * 2 - room if min(ends) < 0 else -LINEAR_BELOW_NS
    return Scale(low, max(ends) * 2 + room, 0.0, WIDTH, LINEAR_BELOW_NS)


def _drift_scale(topics: Iterable[Mapping[str, Any]]) -> Scale:
    """Return a symmetric scale that contains at least the steady part."""
    reaches = [1.2 * DRIFT_LIMIT_PPM]
    reaches += [abs(float(topic["drift_ppm"])) * 1.1 for topic in topics if topic.get("drift_ppm") is not None]
    _, most = nice_ends(0.0, max(reaches), 3)
    return Scale(-most, most, 0.0, WIDTH)


NS_PER_S = 1e9
SPARK = (200.0, 28.0)
SPARK_EDGE, LEAST_SPAN, HEADROOM = 3.0, 1e-9, 1.4
RTK_STYLES = {"fixed": "rtk-fixed", "float": "rtk-float"}
RTK_OTHER = "rtk-other"
RIG = ("FRONT_LEFT", "FRONT", "FRONT_RIGHT", "BACK_LEFT", "BACK", "BACK_RIGHT")


@dataclass(frozen=True)
class CoverageBar:
    """A part of a strip of width 1000; `share` of it is full, 0 to 1."""

    x: float
    width: float
    share: float


@dataclass(frozen=True)
class Spark:
    """A small line: its path, and its lowest, middle and highest value as the caller writes them."""

    path: str
    low: float
    middle: float
    high: float


@dataclass(frozen=True)
class TopicCoverage:
    """One topic: the times of its messages (`bars`), its gaps (`gaps`) and its rate (`rate`)."""

    topic: str
    channel: str
    role: str
    count: int
    rate_hz: float | None
    covered_ratio: float | None
    bars: tuple[CoverageBar, ...]
    gaps: tuple[CoverageBar, ...]
    rate: Spark | None


@dataclass(frozen=True)
class SensorRow:
    """The spark lines of one sensor's messages by name: (title, unit, spark)."""

    name: str
    detail: str
    sparks: tuple[tuple[str, str, Spark], ...]


@dataclass(frozen=True)
class RtkSummary:
    """The receiver's solution along the recording, and its share fixed."""

    topic: str
    fixed_ratio: float
    spans: tuple[PlotSpan, ...]
    plot: Plot


@dataclass(frozen=True)
class RecordingView:
    """A recording's report in pictures."""

    span_s: float
    score: int | None
    deductions: tuple[Mapping[str, Any], ...]
    sensors: tuple[TopicCoverage, ...]
    others: tuple[TopicCoverage, ...]
    clocks: Clocks | None
    rtk: RtkSummary | None
    cameras: tuple[SensorRow, ...]
    lidars: tuple[SensorRow, ...]
    radars: tuple[SensorRow, ...]


def recording_view(inspection: Mapping[str, Any], quality: Mapping[str, Any] | None) -> RecordingView:
    """Return the view; without a quality report, only from the inspection."""
    report = quality or {}
    span_s = float(inspection.get("duration_ns") or 0) / NS_PER_S
    channels = {topic: channel for channel, topic in (inspection.get("channels") or {}).items()}
    rows = [_topic(row, channels, span_s) for row in report.get("coverage") or ()]
    return RecordingView(
        span_s,
        report.get("score"),
        tuple(report.get("deductions") or ()),
        tuple(row for row in rows if row.role not in UNCLOCKED),
        tuple(row for row in rows if row.role in UNCLOCKED),
        clocks_of(inspection.get("clocks") or {}),
        _rtk(report.get("rtk"), span_s),
        tuple(sorted(map(_camera, report.get("cameras") or ()), key=lambda camera: rig_place(camera.name))),
        tuple(map(_lidar, report.get("lidars") or ())),
        tuple(_radar(radar, channels) for radar in report.get("radars") or ()),
    )


def rig_place(channel: str) -> tuple[int, str]:
    """Return the place of a camera among six: front row from left to right, then the back; others after, by name."""
    position = channel.removeprefix("CAM_")
    return (RIG.index(position) if position in RIG else len(RIG), channel)


def spark_of(values: Sequence[float], base: float | None = None) -> Spark | None:
    """Return None without values. The line starts at `base` if given, so that even values look even."""
    if not values:
        return None
    numbers = np.array(values, np.float64)
    low, high = float(numbers.min()), float(numbers.max())
    width, height = SPARK
    x = np.linspace(SPARK_EDGE, width - SPARK_EDGE, len(numbers)) if len(numbers) > 1 else np.array([width / 2])
    bottom = low if base is None else min(low, base)
    top = bottom + max((high - bottom) * HEADROOM, LEAST_SPAN)
    y = Scale(bottom, top, height - SPARK_EDGE, SPARK_EDGE).at(numbers)
    return Spark(line(x, y), low, float(median(values)), high)


def strip(covered: Sequence[float]) -> tuple[CoverageBar, ...]:
    """Return even bins as bars; equal neighbours are merged, empty bins left out."""
    bars = list[CoverageBar]()
    each = 1000 / max(1, len(covered))
    for index, share in enumerate(round(float(value), 2) for value in covered):
        last = bars[-1] if bars else None
        if last is not None and last.share == share and abs(last.x + last.width - index * each) < 0.05:
            bars[-1] = CoverageBar(last.x, round((index + 1) * each - last.x, 2), share)
        elif share > 0:
            bars.append(CoverageBar(round(index * each, 2), round(each, 2), share))
    return tuple(bars)


def _topic(row: Mapping[str, Any], channels: Mapping[str, str], span_s: float) -> TopicCoverage:
    gaps = [marked(start / NS_PER_S, end / NS_PER_S, span_s, "") for start, end in row.get("gaps_ns") or ()]
    return TopicCoverage(
        row["topic"],
        channels.get(row["topic"], ""),
        row["role"],
        int(row["count"]),
        row.get("rate_hz"),
        row.get("covered_ratio"),
        strip(row.get("covered") or ()),
        tuple(CoverageBar(gap.x, gap.width, 1.0) for gap in gaps),
        spark_of(row.get("rates_hz") or (), 0.0),
    )


def _rtk(rtk: Mapping[str, Any] | None, span_s: float) -> RtkSummary | None:
    if not rtk or not rtk.get("at_ns"):
        return None
    at_s = np.array(rtk["at_ns"], np.float64) / NS_PER_S
    stdev = PlotSeries(at_s, np.array(rtk["stdev_m"], np.float64) * 100)
    plot = time_plot(PlotDescription("Horizontal standard deviation (receiver)", "cm", floor=0.0), span_s, [stdev])
    return RtkSummary(
        rtk["topic"], float(rtk.get("fixed_ratio") or 0), _words(at_s.tolist(), rtk["words"], span_s), plot
    )


def _words(at_s: Sequence[float], words: Sequence[str], span_s: float) -> tuple[PlotSpan, ...]:
    """Return consecutive samples of one word as one span, each lasting until the next."""
    ends = [*at_s[1:], span_s]
    spans, start = list[PlotSpan](), 0
    for index, word in enumerate(words):
        if index + 1 == len(words) or words[index + 1] != word:
            spans.append(marked(at_s[start], ends[index], span_s, RTK_STYLES.get(word, RTK_OTHER)))
            start = index + 1
    return tuple(spans)


def _camera(one: Mapping[str, Any]) -> SensorRow:
    wide, high = one.get("size_px") or (0, 0)
    return SensorRow(
        one.get("channel") or one["topic"],
        f"{wide} × {high} px",
        _sparks(("Sharpness", "", one["sharpness"]), ("Brightness", "%", _percent(one["brightness_ratio"]))),
    )


def _lidar(one: Mapping[str, Any]) -> SensorRow:
    slots = median(one["slots"]) if one["slots"] else 0
    sparks = _sparks(("Points returned", "%", _percent(one["valid_ratio"])), ("Median range", "m", one["range_m"]))
    return SensorRow(one["topic"], f"{slots:,.0f} points per sweep", sparks)


def _radar(one: Mapping[str, Any], channels: Mapping[str, str]) -> SensorRow:
    name = channels.get(one["topic"]) or one["topic"]
    return SensorRow(name, f"{len(one['detections'])} scans sampled", _sparks(("Detections", "", one["detections"])))


def _sparks(*named: tuple[str, str, Sequence[float]]) -> tuple[tuple[str, str, Spark], ...]:
    drawn = ((title, unit, spark_of(values, 0.0)) for title, unit, values in named)
    return tuple((title, unit, spark) for title, unit, spark in drawn if spark is not None)


def _percent(ratios: Sequence[float]) -> list[float]:
    return [100 * ratio for ratio in ratios]
