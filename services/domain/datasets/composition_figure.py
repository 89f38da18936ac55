"""The composition figure of a dataset (PNG): environment × illumination, classes, distance, splits.

**Conventions.** The figure is drawn only from the record of `services/domain/datasets/statistics.py`, so figure and
numbers agree; equal records give equal bytes. Texts come from users and are not parsed as formulas. Matplotlib is
imported for the first figure and draws one figure at a time, since it is not thread-safe.
"""

import io
from collections.abc import Mapping
from threading import Lock
from typing import TYPE_CHECKING, Any

from services.domain.datasets.statistics import CLASSES, Record
from stone.labels.class_colours import PALETTES, ColourName, hex_of
from stone.splits.splits import PARTS
from stone.splits.surroundings import DAYLIGHT, HALVES, ILLUMINATIONS
from stone_base.counts import counted

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FIGURE_VERSION = 2
SIZE_IN = (11.0, 7.4)
DPI = 120
INK, SOFT, EMPTY = "#1e2228", "#6a7078", "#c9ccd1"
CLASS_WORDS = dict(zip(CLASSES, ("traversable", "potentially", "non-traversable"), strict=True))
LIGHT_COLOURS = {
    "day": "#f2c14e",
    "sunny": "#f7dd72",
    "overcast": "#b9c4cc",
    "dawn": "#f4a261",
    "dusk": "#d9776c",
    "night": "#22335c",
    "moonlit": "#4a69a5",
    "floodlit": "#8d7fb8",
}
STYLE: dict[Any, Any] = {"font.family": "DejaVu Sans", "font.size": 9.5, "text.color": INK, "axes.labelcolor": INK}
UNSAID_WORD = "unspecified"
FEW = 0.06
_drawing = Lock()


def composition_png(record: Record, title: str, colours: ColourName = "default") -> bytes:
    """Return the figure of this record in the class colours of this palette. An empty dataset has empty axes."""
    with _drawing:
        import matplotlib as mpl
        from matplotlib.figure import Figure

        with mpl.rc_context():
            mpl.rcdefaults()
            mpl.rcParams.update(STYLE)
            figure = Figure(figsize=SIZE_IN, dpi=DPI, facecolor="white", layout="constrained")
            figure.suptitle(title, x=0.01, ha="left", fontsize=13, parse_math=False)
            (frames, classes), (distance, parts) = figure.subplots(2, 2)
            _draw_frames(frames, record)
            _draw_classes(classes, record, colours)
            _draw_distance(distance, record)
            _draw_parts(parts, record)
            content = io.BytesIO()
            figure.savefig(content, format="png", metadata={"Software": None})
            return content.getvalue()


def _draw_frames(axes: "Axes", record: Record) -> None:
    """Draw the frames of each environment, by illumination."""
    words = _in_order({cell["illumination"] for cell in record["cells"]}, ILLUMINATIONS)
    series = {
        word: {c["environment"]: c["frames"] for c in record["cells"] if c["illumination"] == word} for word in words
    }
    rows = [row["key"] for row in record["environments"]]
    _draw_stacks(axes, rows, series, {word: LIGHT_COLOURS.get(word, EMPTY) for word in words})
    _finish_axes(axes, "a  Frames by environment and illumination", "frames")


def _draw_classes(axes: "Axes", record: Record, colours: ColourName) -> None:
    """Draw T, P and N of the occupied voxels: by environment, by day and night, and in total."""
    groups = [*record["environments"], *record["halves"], {**record["total"], "key": "all"}]
    known = [group for group in groups if group["class_ratios"]]
    rows = [group["key"] for group in known]
    series = {name: {g["key"]: 100 * g["class_ratios"][name] for g in known} for name in CLASSES}
    hexes = dict(zip(CLASSES, map(hex_of, PALETTES[colours].values()), strict=True))
    _draw_stacks(axes, rows, series, hexes, CLASS_WORDS)
    for row, group in enumerate(known):
        left = 0.0
        for name in CLASSES:
            ratio = group["class_ratios"][name]
            if ratio >= FEW:
                colour = "white" if name == CLASSES[-1] else INK
                axes.text(left + 50 * ratio, row, f"{100 * ratio:.0f}", ha="center", va="center", color=colour)
            left += 100 * ratio
    axes.set_xlim(0, 100)
    counted_in = record["total"]["voxels_known"]
    hidden = record["total"]["sequences"] - counted_in
    note = f"; {hidden} withheld" if hidden else ""
    _finish_axes(
        axes, "b  Occupied voxels by class", f"% of occupied voxels of {counted(counted_in, 'sequence')}{note}"
    )


def _draw_distance(axes: "Axes", record: Record) -> None:
    """Draw the kilometres driven in each environment, by day and by night."""
    series = dict[str, dict[str, float]]()
    for cell in record["cells"]:
        of_half = series.setdefault(DAYLIGHT.get(cell["illumination"], ""), {})
        of_half[cell["environment"]] = of_half.get(cell["environment"], 0.0) + (cell["distance_m"] or 0.0) / 1000.0
    halves = {half: series[half] for half in _in_order(set(series), HALVES)}
    rows = [row["key"] for row in record["environments"]]
    _draw_stacks(axes, rows, halves, {half: LIGHT_COLOURS.get(half, EMPTY) for half in halves})
    total_km = (record["total"]["distance_m"] or 0.0) / 1000.0
    _finish_axes(axes, f"c  Distance driven: {total_km:.2f} km", "km")


def _draw_parts(axes: "Axes", record: Record) -> None:
    """Draw the frames of each part, with its sequences and minutes beside them."""
    rows = {row["key"]: row for row in record["parts"]}
    keys = _in_order(set(rows), PARTS)
    axes.barh(range(len(keys)), [rows[key]["frames"] for key in keys], color="#3f6f8f", height=0.62)
    most = max((row["frames"] for row in rows.values()), default=1)
    for index, key in enumerate(keys):
        row = rows[key]
        label = f"{counted(row['sequences'], 'sequence')}, {row['duration_s'] / 60:.1f} min"
        axes.text(row["frames"] + 0.015 * most, index, label, va="center", color=SOFT)
    axes.set_xlim(0, 1.6 * most)
    _rows(axes, [key or "unassigned" for key in keys])
    _finish_axes(axes, "d  Splits", "frames")
    axes.xaxis.grid(False)  # it would cross the texts


def _draw_stacks(
    axes: "Axes",
    rows: list[str],
    series: Mapping[str, Mapping[str, float]],
    colours: Mapping[str, str],
    words: Mapping[str, str] | None = None,
) -> None:
    """Draw one horizontal bar per row, a stack of the series."""
    left = [0.0] * len(rows)
    for name, values in series.items():
        widths = [float(values.get(row, 0.0)) for row in rows]
        label = (words or {}).get(name, name) or UNSAID_WORD
        axes.barh(range(len(rows)), widths, left=left, color=colours[name], height=0.62, label=label)
        left = [a + b for a, b in zip(left, widths, strict=True)]
    _rows(axes, [row or UNSAID_WORD for row in rows])
    if series and rows:
        legend = axes.legend(frameon=False, ncols=4, loc="upper left", bbox_to_anchor=(0.0, -0.16), fontsize=8.5)
        for text in legend.get_texts():
            text.set_parse_math(False)


def _rows(axes: "Axes", labels: list[str]) -> None:
    axes.set_yticks(range(len(labels)), labels)
    for text in axes.get_yticklabels():
        text.set_parse_math(False)
    axes.set_ylim(max(len(labels), 1) - 0.4, -0.6)


def _finish_axes(axes: "Axes", title: str, unit: str) -> None:
    axes.set_title(title, loc="left", fontsize=10.5, color=INK, parse_math=False)
    axes.set_xlabel(unit, color=SOFT, loc="right")
    axes.tick_params(length=0, colors=SOFT)
    axes.spines[["top", "right", "left"]].set_visible(False)
    axes.spines["bottom"].set_color(EMPTY)
    axes.xaxis.grid(True, color=EMPTY, linewidth=0.5)
    axes.set_axisbelow(True)


def _in_order(keys: set[str], order: tuple[str, ...]) -> list[str]:
    """Return the words in this order, then other words, '' last."""
    return [*(word for word in order if word in keys), *sorted(keys - {*order, ""}), *([""] if "" in keys else [])]


def figure_title(total: Mapping[str, Any], name: str) -> str:
    """Return `name` with the amount of data."""
    minutes = total["duration_s"] / 60
    return f"{name}: {counted(total['sequences'], 'sequence')}, {counted(total['frames'], 'frame')}, {minutes:.0f} min"
