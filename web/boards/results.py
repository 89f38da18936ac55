"""Scores of a method as figures: totals with whiskers, parts on one axis, the confusion as a matrix.

**Conventions.** Made of what the API answers with, so that what a viewer may not see is not drawn. Rows of the matrix
are the ground truth and are read as shares of their row, since free space outnumbers everything.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from api.schemas.results import BreakdownAnswer, PartItem, ResultsAnswer
from stone.scoring.intervals import SILENCES
from web.boards.comparison import TITLES, Axis, axis_from_zero, axis_over

CLASS_NAMES = ("free", "T", "P", "N")
DOTS = ("miou", "iou_t", "iou_p", "iou_n")
BY_TITLES = {
    "environment": "By environment",
    "illumination": "By illumination",
    "distance": "By distance from the robot",
    "sequence": "By sequence",
}
RING_TITLES = {"0-10m": "0–10 m", "10-20m": "10–20 m", "from-20m": "from 20 m"}
STRONG = 0.55


@dataclass(frozen=True)
class TotalBar:
    """A total from zero; `low` and `length` belong to its interval, `silence` is the reason if it has none, `within` is
    the ratio within occupied truth.
    """

    name: str
    title: str
    value: float | None
    width: str | None
    interval: tuple[float, float] | None
    silence: str | None
    low: str | None
    length: str | None
    within: str | None


@dataclass(frozen=True)
class Totals:
    bars: tuple[TotalBar, ...]
    axis: Axis

    @property
    def silences(self) -> tuple[tuple[str, tuple[str, ...]], ...]:
        """Each reason why there is no interval, with the titles of the ratios without one."""
        reasons = dict.fromkeys(bar.silence for bar in self.bars if bar.silence)
        return tuple((reason, tuple(bar.title for bar in self.bars if bar.silence == reason)) for reason in reasons)


@dataclass(frozen=True)
class Dot:
    name: str
    title: str
    at: str
    value: float


@dataclass(frozen=True)
class PartRow:
    """A part with its dots; those that are undefined are left out."""

    part: PartItem
    title: str
    dots: tuple[Dot, ...]


@dataclass(frozen=True)
class Breakdown:
    by: str
    title: str
    rows: tuple[PartRow, ...]
    axis: Axis


@dataclass(frozen=True)
class MatrixCell:
    """A field of the confusion; `share` is of its row, null where the ground truth has no such voxel."""

    row: int
    column: int
    voxels: int
    share: float | None

    @property
    def opacity(self) -> str:
        return f"{0.0 if self.share is None else max(self.share, 0.02):.3f}"

    @property
    def is_strong(self) -> bool:
        return self.share is not None and self.share > STRONG


def totals(answer: ResultsAnswer) -> Totals:
    values = [getattr(answer.total, name) for name in TITLES]
    within = [] if answer.within_occupied is None else [getattr(answer.within_occupied, name) for name in TITLES]
    ends = [end for name in TITLES for end in _interval(answer, name) or ()]
    axis = axis_from_zero([*values, *within, *ends])
    return Totals(tuple(_bar(answer, name, axis) for name in TITLES), axis)


def breakdowns(answers: Iterable[BreakdownAnswer]) -> tuple[Breakdown, ...]:
    """Return one figure for each breakdown with more than one part, all on the same axis."""
    several = (answer for answer in answers if len(answer.parts) > 1)
    ordered = sorted(several, key=lambda answer: list(BY_TITLES).index(answer.by))
    axis = axis_over(getattr(part.ratios, name) for answer in ordered for part in answer.parts for name in DOTS)
    return tuple(
        Breakdown(answer.by, BY_TITLES[answer.by], tuple(_part(part, axis) for part in answer.parts), axis)
        for answer in ordered
    )


def matrix(confusion: Sequence[Sequence[int]] | None) -> tuple[MatrixCell, ...]:
    """Return the sixteen cells; none if the confusion is not shown."""
    return tuple(
        MatrixCell(row, column, voxels, voxels / sum(counts) if sum(counts) else None)
        for row, counts in enumerate(confusion or ())
        for column, voxels in enumerate(counts)
    )


def _interval(answer: ResultsAnswer, name: str) -> tuple[float, float] | None:
    if answer.intervals is None:
        return None
    interval: tuple[float, float] | None = getattr(answer.intervals.these_places, name)
    return interval


def _silence(answer: ResultsAnswer, name: str) -> str | None:
    code = None if answer.silences is None else answer.silences.these_places[name]
    return None if code is None else SILENCES[code]


def _bar(answer: ResultsAnswer, name: str, axis: Axis) -> TotalBar:
    value, interval = getattr(answer.total, name), _interval(answer, name)
    within = None if answer.within_occupied is None else getattr(answer.within_occupied, name)
    return TotalBar(
        name,
        TITLES[name],
        value,
        None if value is None else axis.width(value),
        interval,
        _silence(answer, name),
        None if interval is None else axis.at(interval[0]),
        None if interval is None else axis.width(interval[1], interval[0]),
        None if within is None else axis.at(within),
    )


def _part(part: PartItem, axis: Axis) -> PartRow:
    known = [(name, value) for name in DOTS if (value := getattr(part.ratios, name)) is not None]
    dots = tuple(Dot(name, TITLES[name], axis.at(value), value) for name, value in known)
    return PartRow(part, RING_TITLES.get(part.name, part.name), dots)
