"""Answers as tables for people; every value comes from the record that `--json` prints.

**Conventions.** An undefined value (null) shows as a dash, never as 0 or 1.
"""

import re
from collections.abc import Mapping, Sequence
from typing import Any

from rich.box import SIMPLE
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from stone_base.errors import one_line

CLASSES = ("free", "T", "P", "N")
DASH = "–"
PIPE_COLUMNS = 120
WHOLE = re.compile(r"[0-9a-f]{32}|\d{4}-\d\d-\d\d|[\d.,+−-]+%?$")
"""Words that no column wraps: an id, a date, a number."""
FOLDED_COLUMNS = 12
"""Other words are wrapped only if they are longer than this."""
QUALITY = ("held out", "gravest")


def show(table: Table) -> None:
    """Print a table on stdout, as wide as the terminal, or wide enough for most names without a terminal.

    A table whose ids, dates and numbers need more width keeps it.
    """
    console = Console()
    if not console.is_terminal:
        console.width = PIPE_COLUMNS
    for column in table.columns:
        column.overflow = "fold"
        column.min_width = max(map(_least_width, (str(column.header), *map(str, column.cells))))
    table.min_width = _least_width(str(table.title))
    console.width = max(console.width, table.min_width)
    console.print(table, crop=False)


def _least_width(text: str) -> int:
    """Return the width at which no id, date, number or short word of the text is wrapped."""
    return max((len(word) if WHOLE.match(word) else min(len(word), FOLDED_COLUMNS) for word in text.split()), default=1)


def plain_table(title: str, *columns: str) -> Table:
    """Return a table whose first column is left-aligned text and whose others are right-aligned numbers."""
    table = Table(title=title, title_justify="left", box=SIMPLE)
    for position, column in enumerate(columns):
        table.add_column(column, justify="left" if position == 0 else "right")
    return table


def quality_cells(item: Mapping[str, Any]) -> tuple[str, str]:
    """Return the columns `QUALITY` of an item: its held-out recall, the code of its gravest finding."""
    recall, gravest = item.get("held_out_recall"), item.get("gravest")
    return DASH if recall is None else f"{100 * recall:.1f} %", gravest["code"] if gravest else DASH


def inspection_table(record: Mapping[str, Any]) -> Table:
    """Return the topics of a recording with their role, rate and gaps (the record of `stone inspect --json`)."""
    duration_s = record["duration_ns"] / 1e9
    table = Table(title=f"{duration_s:.1f} s, {len(record['topics'])} topics", title_justify="left", box=SIMPLE)
    for column in ("topic", "type", "role"):
        table.add_column(column, overflow="fold")
    for column in ("messages", "Hz", "gaps"):
        table.add_column(column, justify="right")
    parts = {topic: part for part, topic in record.get("channels", {}).items()}
    for topic in record["topics"]:
        role = topic["role"] or DASH
        part = parts.get(topic["name"], role)
        rate = DASH if topic["rate_hz"] is None else f"{topic['rate_hz']:.1f}"
        names = (topic["name"], topic["type"].rpartition("/")[2], role if part == role else f"{role} ({part})")
        table.add_row(*map(safe_text, names), str(topic["count"]), rate, str(len(topic["gaps"])))
    return table


def recording_table(recordings: Sequence[Mapping[str, Any]]) -> Table:
    """Return the clock offset of each recording of a run, its standard error and its source."""
    table = Table(title="recordings: clock alignment", title_justify="left", box=SIMPLE)
    table.add_column("recording", overflow="fold")
    for column in ("offset s", "± ms"):
        table.add_column(column, justify="right")
    table.add_column("method")
    for item in recordings:
        error = DASH if item["sigma_ns"] is None else f"{item['sigma_ns'] / 1e6:.2f}"
        table.add_row(safe_text(item["name"]), f"{item['offset_ns'] / 1e9:+.6f}", error, ", ".join(item["known_by"]))
    return table


def clock_table(record: Mapping[str, Any]) -> Table:
    """Return the clock properties of each topic (`clocks` of the record of `stone inspect --json`).

    "jitter ms" is the robust σ against the sensor's own time if its messages have one, else against record time. The
    column "late ms" is the delay of the stamps after the sensor's own time. A camera_info has the stamps of its image
    and is left out.
    """
    lag = record["imu_lag"]
    title = "clocks: record time − stamp"
    if lag is not None:
        lag_text = f"{lag['lag_ns'] / 1e6:+.1f} ± {lag['sigma_ns'] / 1e6:.1f} ms"
        title += f"; gyro of {safe_text(lag['topic'])} late by {lag_text} against {safe_text(lag['reference'])}"
    table = Table(title=title, title_justify="left", box=SIMPLE)
    table.add_column("topic", overflow="fold")
    table.add_column("stamped by")
    for column in ("offset", "ppm", "jitter ms", "late ms", "back", "repeats"):
        table.add_column(column, justify="right")
    for clock in record["topics"]:
        if clock["role"] != "camera_info":
            table.add_row(safe_text(clock["topic"]), clock["stamp_source"], *_clock_numbers(clock))
    return table


def _clock_numbers(clock: Mapping[str, Any]) -> tuple[str, ...]:
    drift_ppm, own_ns, own_jitter_ns = clock["drift_ppm"], clock["own_offset_ns"], clock["own_jitter_ns"]
    jitter_ns = clock["jitter_ns"] if own_jitter_ns is None else own_jitter_ns
    return (
        _offset(clock["offset_ns"], clock["constant"]),
        DASH if drift_ppm is None else f"{drift_ppm:+.1f}",
        DASH if jitter_ns is None else f"{jitter_ns / 1e6:.2f}",
        DASH if own_ns is None else f"{own_ns / 1e6:.1f}",
        str(clock["steps_back"]),
        str(clock["repeats"]),
    )


def _offset(offset_ns: int | None, constant: str) -> str:
    """Return milliseconds up to a second, seconds beyond, with the constant that it is close to."""
    if offset_ns is None:
        return DASH
    if abs(offset_ns) < 1_000_000_000:
        return f"{offset_ns / 1e6:.1f} ms"
    return f"{offset_ns / 1e9:.3f} s{f' ({constant})' if constant else ''}"


READINGS = {"within_occupied": "within occupied", "tolerant": "±1 voxel in height", "columns": "columns"}
"""Other readings of the ratios of a score, by their key in its record."""


def score_table(record: Mapping[str, Any], title: str) -> Table:
    """Return the IoUs by reading, and the danger (the record of `stone score --json`)."""
    readings = [record["total"], *(record[reading] for reading in READINGS)]
    table = plain_table(title, "IoU", "all voxels", *READINGS.values())
    for name, key in (("occupied", "iou_occ"), ("T", "iou_t"), ("P", "iou_p"), ("N", "iou_n"), ("mean T P N", "miou")):
        table.add_row(name, *(_percent(ratios[key]) for ratios in readings))
    for name, key in (("T or P", "n_predicted_drivable_ratio"), ("T", "n_predicted_t_ratio")):
        table.add_row(f"share of N predicted {name}", _percent(record["extras"][key]), *[DASH] * len(READINGS))
    return table


def class_table(title: str, share_of_class: Mapping[str, float]) -> Table:
    """Return the shares of the classes in the occupied voxels."""
    table = plain_table(title, "class", "share")
    for name, share in share_of_class.items():
        table.add_row(name, _percent(share))
    return table


def confusion_table(
    confusion: Sequence[Sequence[int]], rows: str = "ground truth", columns: str = "prediction"
) -> Table:
    """Return the confusion matrix in voxels; `rows` and `columns` are its axis titles."""
    table = plain_table(f"voxels: {rows} in rows, {columns} in columns", "", *CLASSES)
    for name, row in zip(CLASSES, confusion, strict=True):
        table.add_row(name, *(f"{count:,}" for count in row))
    return table


def _percent(ratio: float | None) -> str:
    return DASH if ratio is None else f"{100 * ratio:.1f} %"


def safe_text(text: str) -> str:
    """Return hostile text as plain text: no markup, no control characters."""
    return escape(one_line(text))
