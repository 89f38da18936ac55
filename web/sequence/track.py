"""Plots of a label set's track: position, speed, elevation, and the quality of its poses.

**Conventions.** The map is drawn x to the right and y up; y is north if the poses have an origin on the globe. Times
are seconds since the first frame. A speed is that between the previous and the next frame. Lines break at gaps of
`PAUSE_S`. A pose is sure if RTK was fixed, or if the source has no RTK status.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stone.splits.composition import duration_ns, path_length_m
from web.plots.scales import nice_step
from web.plots.time_plot import Plot, PlotDescription, PlotSeries, PlotSpan, marked, time_plot
from web.sequence.frame_table import NS_PER_S, FrameTable

Floats = NDArray[np.float64]
PAUSE_S = 2.0
MARGIN_RATIO, LEAST_MARGIN_M, LEAST_RATIO = 0.06, 2.0, 0.45
MOST_SQUARES, MOST_POINTS = 12, 4000
SURE, UNSAID = ("fixed",), ("", "unknown")
SERIES_STYLES = ("curve", "curve soft", "curve ink")


@dataclass(frozen=True)
class TrackMap:
    """The track from above, in metres: `view_box` of an SVG whose y grows to the south.

    `sure` and `unsure` are paths; `grid` the lines of squares of `square_m`; `robot_m` the size of a mark.
    """

    view_box: str
    sure: str
    unsure: str
    grid: str
    square_m: float
    start: tuple[float, float]
    end: tuple[float, float]
    mark_m: float
    size_m: tuple[float, float]


@dataclass(frozen=True)
class TrackView:
    """`facts` are figures by name; `points` what the page's cursor reads, one value a frame."""

    ground: TrackMap
    plots: tuple[Plot, ...]
    facts: Mapping[str, float]
    points: Mapping[str, Any]


def track_of(table: FrameTable) -> TrackView | None:
    """Return the view, or None without frames."""
    if not len(table):
        return None
    speeds = speeds_m_s(table)
    heights_m = table.positions_map_m[:, 2]
    facts = {
        "distance_m": path_length_m(table.positions_map_m),
        "duration_s": duration_ns(table.stamps_ns) / NS_PER_S,
        "top_speed_m_s": float(np.nanmax(speeds)) if np.isfinite(speeds).any() else 0.0,
        "climb_m": float(np.maximum(np.diff(heights_m), 0.0).sum()),
        "relief_m": float(np.ptp(heights_m)),
        **({"sure_ratio": float(is_sure(table).mean())} if speaks_of_rtk(table) else {}),
    }
    return TrackView(ground_of(table), plots_of(table, speeds), facts, _points(table, speeds))


def speeds_m_s(table: FrameTable) -> Floats:
    """Return speeds (N,) in m/s; NaN for a single frame and between neighbours `PAUSE_S` apart."""
    if len(table) < 2:
        return np.full(len(table), np.nan)
    before = np.maximum(np.arange(len(table)) - 1, 0)
    after = np.minimum(np.arange(len(table)) + 1, len(table) - 1)
    passed_s = table.times_s[after] - table.times_s[before]
    moved_m = np.linalg.norm(table.positions_map_m[after] - table.positions_map_m[before], axis=1)
    is_known = (passed_s > 0) & (passed_s < 2 * PAUSE_S)
    return np.where(is_known, moved_m / np.where(is_known, passed_s, 1.0), np.nan)


def speaks_of_rtk(table: FrameTable) -> bool:
    """Return whether the source of the poses has an RTK status; odometry has none."""
    return not all(word in UNSAID for word in table.rtk)


def is_sure(table: FrameTable) -> NDArray[np.bool_]:
    """Return whether each position (N,) was as good as possible; always true for a source without RTK status."""
    if not speaks_of_rtk(table):
        return np.ones(len(table), np.bool_)
    return np.array([word in SURE for word in table.rtk], np.bool_)


def ground_of(table: FrameTable) -> TrackMap:
    """Return the track from above with a margin, never thinner than `LEAST_RATIO` of its length."""
    points_m = table.positions_map_m[:, :2] * (1.0, -1.0)
    low, high = points_m.min(axis=0), points_m.max(axis=0)
    longest = float(max(high - low))
    margin = max(longest * MARGIN_RATIO, LEAST_MARGIN_M)
    size = np.maximum(high - low + 2 * margin, LEAST_RATIO * (longest + 2 * margin))
    corner = (low + high) / 2 - size / 2
    square_m = nice_step(float(max(size)), MOST_SQUARES)
    sure = is_sure(table)
    return TrackMap(
        " ".join(f"{value:.2f}" for value in (*corner, *size)),
        _paths(points_m, table.times_s, sure),
        _paths(points_m, table.times_s, ~sure),
        _grid(corner, size, square_m),
        square_m,
        (round(float(points_m[0, 0]), 2), round(float(points_m[0, 1]), 2)),
        (round(float(points_m[-1, 0]), 2), round(float(points_m[-1, 1]), 2)),
        round(float(max(size)) / 90, 3),
        (round(float(size[0]), 2), round(float(size[1]), 2)),
    )


def plots_of(table: FrameTable, speeds: Floats) -> tuple[Plot, ...]:
    """Return plots of speed, elevation and, if the source has it, position accuracy; exclusions are marked."""
    times_s, span_s = table.times_s, float(table.times_s[-1])
    out = excluded_spans(table)
    plots = [
        time_plot(PlotDescription("Speed", "m/s", floor=0.0), span_s, [_series(times_s, speeds)], out),
        time_plot(PlotDescription("Elevation", "m"), span_s, [_series(times_s, table.positions_map_m[:, 2])], out),
    ]
    if np.isfinite(table.stdev_m).any():
        series = [
            _series(times_s, table.stdev_m[:, axis] * 100, SERIES_STYLES[axis], name)
            for axis, name in enumerate(("east", "north", "up"))
        ]
        plots.append(time_plot(PlotDescription("Position standard deviation", "cm", floor=0.0), span_s, series, out))
    if np.isfinite(table.pose_gap_ns).any():
        gaps = [_series(times_s, table.pose_gap_ns / 1e6)]
        plots.append(time_plot(PlotDescription("Pose interval", "ms", floor=0.0), span_s, gaps, out))
    return tuple(plots)


def excluded_spans(table: FrameTable) -> tuple[PlotSpan, ...]:
    """Return the excluded stamps, one mark each; those before the first and after the last frame at the edges."""
    if not len(table) or not table.excluded:
        return ()
    span_s = float(table.times_s[-1])
    at_s = [(excluded_s.stamp_ns - int(table.stamps_ns[0])) / NS_PER_S for excluded_s in table.excluded]
    return tuple(marked(excluded_s, excluded_s, span_s, "left-out-mark") for excluded_s in at_s)


def _series(times_s: Floats, values: Floats, style: str = "curve", name: str = "") -> PlotSeries:
    """Return a series with a break in each pause."""
    pauses = np.flatnonzero(np.diff(times_s) > PAUSE_S) + 1
    return PlotSeries(np.insert(times_s, pauses, times_s[pauses]), np.insert(values, pauses, np.nan), style, name)


def _paths(points_m: Floats, times_s: Floats, wanted: NDArray[np.bool_]) -> str:
    """Return the segments that end in a wanted frame, without those over a pause."""
    legs = np.concatenate([[0], np.cumsum(np.diff(times_s) > PAUSE_S)])
    rows = np.unique([*range(0, len(points_m), max(1, len(points_m) // MOST_POINTS)), len(points_m) - 1]).tolist()
    commands, drawn_to = list[str](), -1
    for before, row in pairwise(rows):
        if wanted[row] and legs[row] == legs[before]:
            commands += [] if drawn_to == before else [f"M{_at(points_m[before])}"]
            commands.append(f"L{_at(points_m[row])}")
            drawn_to = row
    return "".join(commands)


def _at(point_m: Floats) -> str:
    return f"{point_m[0]:.2f} {point_m[1]:.2f}"


def _grid(corner: Floats, size: Floats, square_m: float) -> str:
    """Return lines at whole squares of the map."""
    (left, top), (right, bottom) = corner, corner + size
    across = np.arange(np.ceil(left / square_m), np.floor(right / square_m) + 1) * square_m
    down = np.arange(np.ceil(top / square_m), np.floor(bottom / square_m) + 1) * square_m
    lines = [f"M{x:.2f} {top:.2f}V{bottom:.2f}" for x in across] + [f"M{left:.2f} {y:.2f}H{right:.2f}" for y in down]
    return "".join(lines)


def _points(table: FrameTable, speeds: Floats) -> Mapping[str, Any]:
    return {
        "tokens": list(table.tokens),
        "times_s": np.round(table.times_s, 3).tolist(),
        "x_m": np.round(table.positions_map_m[:, 0], 2).tolist(),
        "y_m": np.round(table.positions_map_m[:, 1], 2).tolist(),
        "elevation_m": np.round(table.positions_map_m[:, 2], 2).tolist(),
        "speed_m_s": [None if np.isnan(speed) else round(float(speed), 2) for speed in speeds],
    }
