"""Comparison of two leaderboard entries, as figures and in words.

**Conventions.** Differences are points of per cent, a − b; words always speak of the better one. "Surely" means that
the two-sided p, about these places, is at most 1 − the level of the intervals. Whole sequences answer another question,
whether it would hold in a new place, and are told apart from it. Where nothing can be said, the reason is.
"""

from dataclasses import dataclass

from api.schemas.leaderboard import ComparisonAnswer, DifferenceItem, RatioDifferenceItem
from stone.scoring.silences import SILENCES, Scope
from web.boards.axes import Axis, axis_around_zero, axis_from_zero

TITLES = {"miou": "mIoU", "iou_occ": "IoU occ", "iou_t": "IoU T", "iou_p": "IoU P", "iou_n": "IoU N"}
MINUS = "−"


@dataclass(frozen=True)
class Names:
    """The names of the two entries."""

    a: str
    b: str


@dataclass(frozen=True)
class ComparisonVerdict:
    """The sentence that answers the question, and what it rests on."""

    headline: str
    grounds: tuple[str, ...]


@dataclass(frozen=True)
class DifferenceSpan:
    """An interval of differences on the axis."""

    low: str
    length: str
    said: str


@dataclass(frozen=True)
class ComparedRow:
    """One ratio of both: widths of the bars, and where the difference lies; null is undefined or not shown."""

    name: str
    title: str
    found: RatioDifferenceItem
    a_width: str | None
    b_width: str | None
    at: str | None
    these_places: DifferenceSpan | None
    new_place: DifferenceSpan | None


@dataclass(frozen=True)
class ComparisonFigures:
    """The figures: bars from zero on one axis, differences around zero on another."""

    rows: tuple[ComparedRow, ...]
    bars: Axis
    differences: Axis
    verdict: ComparisonVerdict


def compared(answer: ComparisonAnswer, names: Names) -> ComparisonFigures:
    ratios = answer.ratios
    bars = axis_from_zero(value for found in ratios.values() for value in (found.a, found.b))
    reach = [value for found in ratios.values() for value in (found.difference, *_ends(found))]
    differences = axis_around_zero(reach)
    rows = tuple(_row(name, ratios[name], bars, differences) for name in TITLES)
    return ComparisonFigures(rows, bars, differences, verdict(answer, names))


def verdict(answer: ComparisonAnswer, names: Names) -> ComparisonVerdict:
    """The verdict in words: the better in mIoU, by how much, how surely."""
    found = answer.ratios["miou"]
    if found.difference is None:
        return ComparisonVerdict(
            "The two entries cannot be ordered", ("One of them has no mIoU: a class is undefined.",)
        )
    better, worse = (names.a, names.b) if found.difference >= 0 else (names.b, names.a)
    margin = f"{better} is ahead by {abs(100 * found.difference):.2f} points of mIoU."
    if found.difference == 0:
        return ComparisonVerdict(f"{names.a} and {names.b} have the same mIoU", (_uncertain(answer, found),))
    if answer.is_withheld or found.these_places is None:
        return ComparisonVerdict(f"{better} is ahead of {worse}", (margin, _uncertain(answer, found)))
    grounds = (margin, _here(answer, found.difference, found.these_places), *_elsewhere(answer, found))
    if found.these_places.p > 1 - answer.interval_level:
        return ComparisonVerdict(f"No significant difference between {names.a} and {names.b}", grounds)
    return ComparisonVerdict(f"{better} is better than {worse}", grounds)


def signed(difference: float) -> str:
    """`+1.13`, in points of per cent."""
    points = 100 * difference
    return f"{MINUS if points < 0 else '+'}{abs(points):.2f}"


def _uncertain(answer: ComparisonAnswer, found: RatioDifferenceItem) -> str:
    if answer.is_withheld:
        return "Significance is shown when the phase has ended: until then its ground truth is hidden."
    if found.these_places is None:
        return f"No significance test: {_silence(found, 'these_places')}."
    return _here(answer, found.difference or 0.0, found.these_places)


def _here(answer: ComparisonAnswer, difference: float, told: DifferenceItem) -> str:
    """The interval of the better one's margin."""
    low, high = told.interval if difference >= 0 else (-told.interval[1], -told.interval[0])
    level = round(100 * answer.interval_level)
    return f"On these sequences the margin is {signed(low)} to {signed(high)} ({level} % interval, {_p(told.p)})."


def _elsewhere(answer: ComparisonAnswer, found: RatioDifferenceItem) -> tuple[str, ...]:
    told = found.new_place
    if told is None:
        return (f"No statement about new places: {_silence(found, 'new_place')}.",)
    if told.p <= 1 - answer.interval_level:
        return (f"It also holds across whole sequences, so it is likely to hold in new places ({_p(told.p)}).",)
    return (f"Whether it holds in new places is open: across whole sequences {_p(told.p)}.",)


def _silence(found: RatioDifferenceItem, scope: Scope) -> str:
    code = (found.silences or {}).get(scope)
    return "it is not known" if code is None else SILENCES[code]


def _p(value: float) -> str:
    return f"p = {value:.2g}" if value >= 0.001 else "p < 0.001"


def _row(name: str, found: RatioDifferenceItem, bars: Axis, differences: Axis) -> ComparedRow:
    return ComparedRow(
        name,
        TITLES[name],
        found,
        None if found.a is None else bars.width(found.a),
        None if found.b is None else bars.width(found.b),
        None if found.difference is None else differences.at(found.difference),
        _span(found.these_places, differences),
        _span(found.new_place, differences),
    )


def _span(found: DifferenceItem | None, axis: Axis) -> DifferenceSpan | None:
    if found is None:
        return None
    low, high = found.interval
    return DifferenceSpan(axis.at(low), axis.width(high, low), f"{signed(low)} to {signed(high)}, {_p(found.p)}")


def _ends(found: RatioDifferenceItem) -> tuple[float, ...]:
    return tuple(end for told in (found.these_places, found.new_place) if told is not None for end in told.interval)
