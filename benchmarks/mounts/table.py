"""The rows of `benchmarks.mounts` as a Markdown table: a row per wrong mount, the drives beside each other."""

from collections.abc import Mapping
from typing import Any

# by drive, by wrong mount ("" is the right one)
MountRows = Mapping[str, Mapping[str, Mapping[str, Any]]]


def shown(made: MountRows) -> str:
    """Return the table of each mount's remaining error, then of the IoUs."""
    names = list(next(iter(made.values())))
    left = [[name or "right", *(_left(made[drive][name]) for drive in made)] for name in names]
    ious = [[name, *(_ious(made[drive][name]) for drive in made)] for name in names if name]
    head = "mount entered"
    return "\n\n".join((_table([head, *made], left), _table([f"{head}: IoU of T ∪ P, of all", *made], ious)))


def _left(row: Mapping[str, Any]) -> str:
    if "refusal" in row:
        return f"refused: {row['refusal']}"
    return f"{100 * row['height_m']:+.1f} cm, {row['tilt_deg']:.2f}°"


def _ious(row: Mapping[str, Any]) -> str:
    if "refusal" in row:
        return ""
    return "; ".join(f"{row[way]['drivable']:.3f}, {row[way]['all']:.3f}" for way in ("given", "auto"))


def _table(heads: list[str], rows: list[list[str]]) -> str:
    return "\n".join(_line(cells) for cells in (heads, ["---"] * len(heads), *rows))


def _line(cells: list[str]) -> str:
    return f"| {' | '.join(cells)} |"
