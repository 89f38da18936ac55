"""Lines over time as SVG inside the page, with the page's colours and real text.

**Conventions.** Times are seconds since the recording's start. Only numbers and our own words enter a plot, never a
name from the recording: a `$` would be a formula to matplotlib. Colours are placeholders that become the page's
variables, so one picture serves light and dark. Equal values give equal bytes: no dates, ids by the plot's own name.
"""

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from io import StringIO
from typing import Any

import matplotlib as mpl
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator

SERIES_COLOURS = 8
# Placeholders that no drawing would contain by chance, by the name of the page's variable.
COLOURS = {
    "ink": "#010203", "soft": "#010204", "line": "#010205", "bad": "#010206", "ok": "#010207", "warn": "#010208",
    **{f"c{index}": f"#01030{index}" for index in range(SERIES_COLOURS)},
}  # fmt: skip
WIDTH_IN, HEIGHT_IN = 4.5, 2.2
LEAST_SIDE_MS = 2.0
SVG_HEAD = (
    r'<svg viewBox="\1" xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink"'
    r' aria-hidden="true" focusable="false">'
)
STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 9.5,
    "axes.linewidth": 0.8,
    "text.parse_math": False,
    "path.simplify": True,
}


@dataclass(frozen=True)
class PlotLine:
    """(N,) times and values; `colour` is a name in `COLOURS`."""

    times_s: tuple[float, ...]
    values: tuple[float, ...]
    colour: str
    has_points: bool = False


@dataclass(frozen=True)
class Frame:
    """The frame of a plot: `name` is unique on the page, `low` and `high` are optional bounds of the values."""

    name: str
    span_s: float
    label: str
    low: float | None = None
    high: float | None = None
    is_log: bool = False


@contextmanager
def drawing_style(salt: str = "stone") -> Iterator[None]:
    """Apply matplotlib's defaults and ours within the block, whatever the machine's matplotlibrc contains."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update({**STYLE, "svg.hashsalt": salt})
        yield


def series_colour(place: int) -> str:
    """Return the colour of the line at `place`; colours repeat after eight."""
    return f"c{place % SERIES_COLOURS}"


def time_plot(frame: Frame, lines: Sequence[PlotLine]) -> Markup:
    """Return an `<svg>` element."""
    figure, axes = _empty(HEIGHT_IN)
    for line in lines:
        marker = {"marker": "o", "markersize": 2.6, "markeredgewidth": 0} if line.has_points else {}
        axes.plot(line.times_s, line.values, color=COLOURS[line.colour], linewidth=1.3, **marker)  # type: ignore[arg-type]
    axes.set_xlim(0, max(frame.span_s, 1e-3))
    axes.set_xlabel("s since the start", color=COLOURS["soft"])
    axes.set_ylabel(frame.label, color=COLOURS["soft"])
    _scaled(axes, frame)
    return _svg(figure, frame.name)


def offset_plot(plot_name: str, offsets_ms: Sequence[tuple[float, float, str]]) -> Markup:
    """Draw one numbered row per (offset, jitter, colour), milliseconds: a dot at the offset, a bar as wide as the
    jitter.
    """
    figure, axes = _empty(0.55 + 0.2 * len(offsets_ms))
    rows = range(1, len(offsets_ms) + 1)
    for row, (offset_ms, jitter_ms, colour) in zip(rows, offsets_ms, strict=True):
        ends = [offset_ms - jitter_ms, offset_ms + jitter_ms]
        axes.plot(ends, [row, row], color=COLOURS[colour], linewidth=3, alpha=0.45, solid_capstyle="round")
        axes.plot([offset_ms], [row], color=COLOURS[colour], marker="o", markersize=4.5, markeredgewidth=0)
    axes.axvline(0, color=COLOURS["soft"], linewidth=0.8)
    axes.set_xscale("symlog", linthresh=10.0)
    ends_ms = [offset_ms + sign * jitter_ms for offset_ms, jitter_ms, _ in offsets_ms for sign in (-1, 1)]
    axes.set_xlim(2 * min(-LEAST_SIDE_MS, *ends_ms), 2 * max(LEAST_SIDE_MS, *ends_ms))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(FuncFormatter(_plain))
    axes.set_ylim(len(offsets_ms) + 0.6, 0.4)
    axes.set_yticks(list(rows))
    axes.set_xlabel("ms from stamp to recording", color=COLOURS["soft"])
    return _svg(figure, plot_name)


def _empty(height_in: float) -> tuple[Figure, Axes]:
    with drawing_style():
        figure = Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
        axes = figure.add_subplot()
        figure.patch.set_visible(False)
        axes.patch.set_visible(False)
        axes.grid(True, color=COLOURS["line"], linewidth=0.6)
        axes.set_axisbelow(True)
        axes.tick_params(colors=COLOURS["soft"], length=0)
        for side in ("top", "right", "left"):
            axes.spines[side].set_visible(False)
        axes.spines["bottom"].set_color(COLOURS["line"])
    return figure, axes


def _scaled(axes: Axes, frame: Frame) -> None:
    if frame.is_log:
        axes.set_yscale("log")
        axes.yaxis.set_major_locator(LogLocator(base=10, subs=(1.0, 2.0, 5.0), numticks=12))
        axes.yaxis.set_major_formatter(FuncFormatter(_plain))
        axes.yaxis.set_minor_formatter(NullFormatter())
        axes.yaxis.set_minor_locator(NullLocator())
    low, high = axes.get_ylim()
    axes.set_ylim(low if frame.low is None else frame.low, high if frame.high is None else frame.high)


def _plain(value: float, _place: int) -> str:
    return f"{value:,.0f}".replace(",", " ") if abs(value) >= 1000 else f"{value:g}"


def _svg(figure: Figure, plot_name: str) -> Markup:
    """Return the SVG without prologue, metadata and ids of groups, which would repeat on the page.

    The plot's name salts the ids of markers and clips, which are referred to.
    """
    stream = StringIO()
    with drawing_style(plot_name):
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    drawn = stream.getvalue()
    drawn = drawn[drawn.index("<svg") :]
    drawn = re.sub(r"<metadata>.*?</metadata>\s*", "", drawn, flags=re.DOTALL)
    drawn = re.sub(r' id="(?![mp][0-9a-f]{10}")[^"]*"', "", drawn)
    drawn = re.sub(r'<svg [^>]*?viewBox="([^"]+)"[^>]*>', SVG_HEAD, drawn, count=1)
    for variable, placeholder in COLOURS.items():
        drawn = drawn.replace(placeholder, f"var(--{variable})")
    return Markup(drawn)


# Bars along the recording's time that stretch to the page's width. x is 0 to 1000 over the recording. Bars are
# decoration: words or numbers beside them give the same information.


WIDTH = 1000


@dataclass(frozen=True)
class StripBar:
    """One bar: `swatch` is its class, `opacity` 0 to 1."""

    swatch: str
    x: float
    width: float
    opacity: float = 1.0


def cover_strip(covered: Sequence[float], gaps: Sequence[tuple[float, float]]) -> tuple[StripBar, ...]:
    """Return bars for bins, as opaque as they are covered; `gaps` are (start, end) as shares of the recording, in
    red.
    """
    bars = [_bar("cover", start / len(covered), end / len(covered), share) for start, end, share in _runs(covered)]
    return (*bars, *(_bar("gap", start, end) for start, end in gaps))


def span_strip(first: float, last: float) -> tuple[StripBar, ...]:
    """Return a bar from the first to the last message of a topic without a period, as shares of the recording."""
    return (_bar("loose", first, last),)


def word_strip(at: Sequence[float], swatches: Sequence[str]) -> tuple[StripBar, ...]:
    """Return consecutive samples of one swatch as one bar, each lasting to the next sample; `at` are ascending
    shares.
    """
    ends = [*at[1:], 1.0]
    bars: list[StripBar] = []
    start = 0
    for index, swatch in enumerate(swatches):
        if index + 1 == len(swatches) or swatches[index + 1] != swatch:
            bars.append(_bar(swatch, at[start], ends[index]))
            start = index + 1
    return tuple(bars)


def _bar(swatch: str, start: float, end: float, opacity: float = 1.0) -> StripBar:
    """Return a bar at least 2 of the 1000 wide, so that it is visible."""
    left = min(max(0.0, start), 1.0) * WIDTH
    return StripBar(swatch, left, max(2.0, min(max(0.0, end), 1.0) * WIDTH - left), opacity)


def _runs(covered: Sequence[float]) -> list[tuple[int, int, float]]:
    """Return (first bin, bin after the last, share) of equal neighbours; empty bins are left out."""
    runs: list[tuple[int, int, float]] = []
    for index, share in enumerate(round(value, 2) for value in covered):
        if runs and runs[-1][1] == index and runs[-1][2] == share:
            runs[-1] = (runs[-1][0], index + 1, share)
        elif share > 0:
            runs.append((index, index + 1, share))
    return runs
