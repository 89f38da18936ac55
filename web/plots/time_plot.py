"""Values over time as one plot: curves, bands of notable times, ticks beside them.

**Conventions.** Times are seconds since the start of what is shown. Ticks along time are percent of the width, those of
values are pixels from the top; a plot is `WIDTH` units wide.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from web.plots.paths import band, dots, line
from web.plots.scales import Scale, nice_ends, nice_step, tick_text, ticks

Floats = NDArray[np.float64]
WIDTH = 1000.0
HEIGHT_PX, EDGE_PX = 120.0, 6.0
MOST_X_TICKS, MOST_Y_TICKS = 6, 4


@dataclass(frozen=True)
class PlotTick:
    """A value beside an axis: `at` is percent along x, pixels along y."""

    at: float
    text: str


@dataclass(frozen=True)
class Curve:
    """Path data and the class that it is drawn with (`styles/charts.css`, `styles/sequence.css`)."""

    style: str
    path: str
    name: str = ""


@dataclass(frozen=True)
class PlotSpan:
    """A part of the time that is marked: `x` and `width` in the plot's units."""

    x: float
    width: float
    style: str


@dataclass(frozen=True)
class Plot:
    """`text` describes the picture for screen readers."""

    title: str
    unit: str
    text: str
    curves: tuple[Curve, ...]
    x_ticks: tuple[PlotTick, ...]
    y_ticks: tuple[PlotTick, ...]
    spans: tuple[PlotSpan, ...] = ()
    height_px: float = HEIGHT_PX
    width: float = WIDTH


@dataclass(frozen=True, eq=False)
class PlotSeries:
    """(N,) times and values of one curve; NaN for unknown values. `is_dots`: points that are not connected."""

    times_s: Floats
    values: Floats
    style: str = "curve"
    name: str = ""
    is_dots: bool = False


@dataclass(frozen=True)
class PlotDescription:
    """Title and unit of a plot; `floor` and `ceiling` are values that its axis reaches at least."""

    title: str
    unit: str
    floor: float | None = None
    ceiling: float | None = None


def time_plot(
    about: PlotDescription, span_s: float, series: Sequence[PlotSeries], spans: Sequence[PlotSpan] = ()
) -> Plot:
    """Plot series over [0, `span_s`]. Without a known value the axis is 0 to 1, and `text` states it."""
    known = np.concatenate([curve.values[np.isfinite(curve.values)] for curve in series] or [np.empty(0)])
    low, high = _ends(about, known)
    x, y = Scale(0.0, span_s, 0.0, WIDTH), Scale(low, high, HEIGHT_PX - EDGE_PX, EDGE_PX)
    return Plot(
        about.title,
        about.unit,
        _describe(about, known),
        tuple(_curve(curve, x, y) for curve in series),
        time_ticks(span_s),
        _y_ticks(low, high, y),
        tuple(spans),
    )


def stacked_shares(times_s: Floats, counts: Floats, styles: Sequence[str]) -> tuple[Curve, ...]:
    """Return counts (N, C) at N times as shares of each time, one filled band per column, the first at the bottom."""
    total = np.maximum(counts.sum(axis=1, keepdims=True), 1.0)
    edges = np.concatenate([np.zeros((len(counts), 1)), np.cumsum(counts / total, axis=1)], axis=1)
    rows = np.unique(np.linspace(0, len(times_s) - 1, min(len(times_s), int(WIDTH))).round().astype(int))
    span_s = float(times_s[-1]) if len(times_s) else 0.0
    x = Scale(0.0, span_s, 0.0, WIDTH).at(times_s[rows])
    y = Scale(0.0, 1.0, HEIGHT_PX, 0.0)
    return tuple(
        Curve(style, band(x, y.at(edges[rows, number]), y.at(edges[rows, number + 1])))
        for number, style in enumerate(styles)
    )


def time_ticks(span_s: float) -> tuple[PlotTick, ...]:
    """Return ticks in seconds, or in minutes and seconds for a long span; the last tick stays clear of the edge."""
    step = nice_step(span_s, MOST_X_TICKS)
    return tuple(PlotTick(100 * at / span_s, _clock(at, step)) for at in ticks(0.0, span_s, MOST_X_TICKS) if span_s > 0)


def marked(start_s: float, end_s: float, span_s: float, style: str) -> PlotSpan:
    """Return a part of [0, `span_s`], at least 2 units wide so that it is visible."""
    x = Scale(0.0, span_s, 0.0, WIDTH)
    left, right = x.one(start_s), x.one(end_s)
    return PlotSpan(round(min(left, WIDTH - 2), 1), round(max(right - left, 2.0), 1), style)


def _ends(about: PlotDescription, known: Floats) -> tuple[float, float]:
    bounds = [value for value in (about.floor, about.ceiling) if value is not None]
    values = [*known.tolist(), *bounds] or [0.0, 1.0]
    return nice_ends(min(values), max(values), MOST_Y_TICKS)


def _curve(one: PlotSeries, x: Scale, y: Scale) -> Curve:
    draw = dots if one.is_dots else line
    return Curve(one.style, draw(x.at(one.times_s), y.at(one.values)), one.name)


def _y_ticks(low: float, high: float, y: Scale) -> tuple[PlotTick, ...]:
    step = nice_step(high - low, MOST_Y_TICKS)
    return tuple(PlotTick(round(y.one(at), 1), tick_text(at, step)) for at in ticks(low, high, MOST_Y_TICKS))


def _clock(at_s: float, step_s: float) -> str:
    if step_s >= 60:
        return f"{at_s / 60:.0f} min"
    return f"{tick_text(at_s, step_s)} s"


def _describe(about: PlotDescription, known: Floats) -> str:
    if not len(known):
        return f"{about.title}: no data"
    low, middle, high = np.quantile(known, (0.0, 0.5, 1.0)).tolist()
    return f"{about.title}: from {low:.3g} to {high:.3g} {about.unit}, median {middle:.3g}".replace(" ,", ",")
