"""The track on a plot: north up, its length in the title, coloured by how well the receiver knew where it was.

**Conventions.** Metres, equal scales. Start is a ring, end a square.
"""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from stone_recordings.report.previews.canvas import INK, LINE, SOFT, TEXT_POINTS, dressed, png, square_figure
from stone_recordings.report.previews.track import RecordedTrack
from stone_recordings.report.quality.plots import drawing_style

COLOUR_OF_WORD = {"fixed": "#6ecb87", "float": "#f0b45a", "other": "#ff7a6e"}
LABEL_OF_WORD = {"fixed": "RTK fixed", "float": "RTK float", "other": "neither"}
UNKNOWN_COLOUR = "#6db6f2"
MARGIN_RATIO, LEAST_SPAN_M = 0.08, 2.0


def track_view(track: RecordedTrack) -> bytes:
    """PNG."""
    with drawing_style():
        figure = square_figure()
        axes = figure.add_subplot()
        steps_m = np.linalg.norm(np.diff(track.points_m, axis=0), axis=1)
        dressed(axes, _labels(track), f"{steps_m.sum():,.0f} m by {track.source}".replace(",", " "))
        axes.grid(True, color=LINE, linewidth=0.6)
        axes.set_axisbelow(True)
        _bounded(axes, track)
        _line(axes, track)
        _legend(figure, track)
        return png(figure)


def _labels(track: RecordedTrack) -> tuple[str, str]:
    return ("east of the start, m", "north of the start, m") if track.is_geodetic else ("x, m", "y, m")


def _bounded(axes: Axes, track: RecordedTrack) -> None:
    """A square around the track, so that a straight drive is not a hair."""
    low, high = track.points_m.min(axis=0), track.points_m.max(axis=0)
    middle = (low + high) / 2
    half = max(float((high - low).max()), LEAST_SPAN_M) * (0.5 + MARGIN_RATIO)
    axes.set_xlim(middle[0] - half, middle[0] + half)
    axes.set_ylim(middle[1] - half, middle[1] + half)


def _line(axes: Axes, track: RecordedTrack) -> None:
    segments = np.stack([track.points_m[:-1], track.points_m[1:]], axis=1)
    colours = [COLOUR_OF_WORD[word] for word in track.words[1:]] or UNKNOWN_COLOUR
    axes.add_collection(LineCollection(list(segments), colors=colours, linewidths=3, capstyle="round"))
    start, end = track.points_m[0], track.points_m[-1]
    axes.plot([start[0]], [start[1]], "o", color=INK, markersize=10, markerfacecolor="none", markeredgewidth=2)
    axes.plot([end[0]], [end[1]], "s", color=INK, markersize=8)


def _legend(figure: Figure, track: RecordedTrack) -> None:
    """Below the plot, where no track runs."""
    entries = [
        Line2D([], [], color=INK, marker="o", markerfacecolor="none", linestyle="none", label="start"),
        Line2D([], [], color=INK, marker="s", linestyle="none", label="end"),
    ]
    entries += [
        Line2D([], [], color=colour, linewidth=3, label=LABEL_OF_WORD[word])
        for word, colour in COLOUR_OF_WORD.items()
        if word in track.words
    ]
    figure.legend(
        handles=entries,
        loc="outside lower center",
        ncols=len(entries),
        columnspacing=1.2,
        handlelength=1.4,
        frameon=False,
        labelcolor=SOFT,
        fontsize=TEXT_POINTS,
    )
