"""Answers as tables for people; every value comes from the record that `--json` prints.

**Conventions.** A value that is undefined (null) shows as a dash, never as 0 or 1.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from rich.box import SIMPLE
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from client.streams import one_line

CLASSES = ("free", "T", "P", "N")
DASH = "–"
PIPE_COLUMNS = 120


def show(table: Table) -> None:
    """Print a table on stdout, as wide as the terminal, or wide enough for most names where there is none."""
    console = Console()
    if not console.is_terminal:
        console.width = PIPE_COLUMNS
    console.print(table)


def plain_table(title: str, *columns: str) -> Table:
    """A table whose first column is text and whose others are numbers, right-aligned."""
    table = Table(title=title, title_justify="left", box=SIMPLE)
    for position, column in enumerate(columns):
        table.add_column(column, justify="left" if position == 0 else "right")
    return table


def inspection_table(record: Mapping[str, Any]) -> Table:
    """Topics of a recording with their role, rate and gaps (the record of `stone inspect --json`)."""
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


def score_table(record: Mapping[str, Any], title: str) -> Table:
    """The IoUs over all voxels and within occupied ground truth (the record of `stone score --json`)."""
    within = record["iou_within_occupied"]
    table = plain_table(title, "IoU", "all voxels", "within occupied")
    for name, key in (("occupied", "iou_occ"), ("T", "iou_t"), ("P", "iou_p"), ("N", "iou_n"), ("mean T P N", "miou")):
        table.add_row(name, _percent(record[key]), _percent(within.get(key)))
    return table


def class_table(title: str, share_of_class: Mapping[str, float]) -> Table:
    """How the occupied voxels divide between the classes."""
    table = plain_table(title, "class", "share")
    for name, share in share_of_class.items():
        table.add_row(name, _percent(share))
    return table


def confusion_table(confusion: Sequence[Sequence[int]]) -> Table:
    """Rows are ground truth, columns prediction, cells voxels."""
    table = plain_table("voxels: ground truth in rows, prediction in columns", "", *CLASSES)
    for name, row in zip(CLASSES, confusion, strict=True):
        table.add_row(name, *(f"{count:,}" for count in row))
    return table


def _percent(ratio: float | None) -> str:
    return DASH if ratio is None else f"{100 * ratio:.1f} %"


def safe_text(text: str) -> str:
    """Somebody else's text as plain text: no markup, no control characters."""
    return escape(one_line(text))
