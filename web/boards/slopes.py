"""Slope charts: ranks before and after a change, as lines between two columns.

**Conventions.** Units of an SVG `WIDTH` wide; a rank is a row of `ROW`. Only what has a rank on a side stands there;
ties stand one below the other.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from api.schemas.rescores import MovedItem

WIDTH, ROW, TOP = 760.0, 26.0, 20.0
LEFT, RIGHT = 270.0, 490.0
LONGEST = 30


@dataclass(frozen=True)
class SlopeEnd:
    """A name on one side; `y` is the middle of its row."""

    y: float
    rank: int
    name: str


@dataclass(frozen=True)
class Slope:
    """A line from old to new place; `move` is up, down or same."""

    from_y: float
    to_y: float
    move: str


@dataclass(frozen=True)
class SlopePicture:
    """The whole figure; columns of names at `LEFT` and `RIGHT`."""

    height: float
    old: tuple[SlopeEnd, ...]
    new: tuple[SlopeEnd, ...]
    slopes: tuple[Slope, ...]
    left: float = LEFT
    right: float = RIGHT
    width: float = WIDTH


def slope_picture(rows: Sequence[MovedItem]) -> SlopePicture | None:
    """Return the figure of these rows, or None if no row is ranked."""
    old = _column([(row.old_rank, row) for row in rows if row.old_rank is not None])
    new = _column([(row.new_rank, row) for row in rows if row.new_rank is not None])
    if not old and not new:
        return None
    both = [row for row in rows if row.submission_id in old and row.submission_id in new]
    slopes = tuple(Slope(old[row.submission_id].y, new[row.submission_id].y, _move(row)) for row in both)
    height = TOP + ROW * max(len(old), len(new))
    return SlopePicture(height, tuple(old.values()), tuple(new.values()), slopes)


def _column(ranked: Sequence[tuple[int, MovedItem]]) -> dict[str, SlopeEnd]:
    ordered = sorted(ranked, key=lambda one: (one[0], one[1].method, one[1].submission_id))
    return {
        row.submission_id: SlopeEnd(TOP + ROW * (index + 0.5), rank, _named(row))
        for index, (rank, row) in enumerate(ordered)
    }


def _named(row: MovedItem) -> str:
    name = f"{row.method} · {row.team}"
    return name if len(name) <= LONGEST else f"{name[: LONGEST - 1]}…"


def _move(row: MovedItem) -> str:
    moved = row.rank_move or 0
    return "up" if moved > 0 else "down" if moved < 0 else "same"


@dataclass(frozen=True)
class SparkBar:
    """A bar from the ground up, in the figure's own units; `count` is what it stands for."""

    x: float
    y: float
    width: float
    height: float
    count: int


def bars(counts: Sequence[int], width: float, height: float, gap: float = 1.0) -> list[SparkBar]:
    """Return a bar per count over `width` × `height`; the highest fills the height, a zero is minimally high."""
    most, step = max([1, *counts]), width / max(1, len(counts))
    heights = [max(1.0, height * count / most) for count in counts]
    return [
        SparkBar(round(index * step, 2), round(height - tall, 2), round(step - gap, 2), round(tall, 2), count)
        for index, (count, tall) in enumerate(zip(counts, heights, strict=True))
    ]
