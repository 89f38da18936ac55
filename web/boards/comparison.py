"""Comparison of two leaderboard entries, as figures and in words.

**Conventions.** Differences are points of per cent, a − b; words always speak of the better one. "Surely" means that
the two-sided p of the paired block draws is at most 1 − the level of the intervals. Sequences answer another question,
whether it would hold in a new place, and are told apart from it.
"""

from dataclasses import dataclass

from api.schemas.leaderboard import ComparisonAnswer, DifferenceItem, RatioDifferenceItem
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
    block: DifferenceSpan | None
    sequence: DifferenceSpan | None


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
        return ComparisonVerdict("The two cannot be put in order", ("One of them has no mIoU: a class is undefined.",))
    better, worse = (names.a, names.b) if found.difference >= 0 else (names.b, names.a)
    margin = f"{better} is ahead by {abs(100 * found.difference):.2f} points of mIoU."
    if found.difference == 0:
        return ComparisonVerdict(f"{names.a} and {names.b} have the same mIoU", (_uncertain(answer, found),))
    if answer.is_withheld or found.block is None:
        return ComparisonVerdict(f"{better} is ahead of {worse}", (margin, _uncertain(answer, found)))
    if found.block.p > 1 - answer.interval_level:
        return ComparisonVerdict(
            f"{names.a} and {names.b} do not surely differ", (margin, _by_frames(answer, found), *_elsewhere(found))
        )
    return ComparisonVerdict(
        f"{better} is better than {worse}", (margin, _by_frames(answer, found), *_elsewhere(found))
    )


def signed(difference: float) -> str:
    """`+1.13`, in points of per cent."""
    points = 100 * difference
    return f"{MINUS if points < 0 else '+'}{abs(points):.2f}"


def _uncertain(answer: ComparisonAnswer, found: RatioDifferenceItem) -> str:
    if answer.is_withheld:
        return (
            "Whether that is more than chance is told when the phase has ended: until then its ground truth is hidden."
        )
    if found.block is None:
        return "Resampling says nothing of it: every sequence is shorter than a block of frames."
    return _by_frames(answer, found)


def _by_frames(answer: ComparisonAnswer, found: RatioDifferenceItem) -> str:
    block = found.block
    if block is None or block.interval is None:
        return "No interval can be given: in a draw one of them is undefined."
    low, high = _towards(found, block)
    level = round(100 * answer.interval_level)
    return f"On this ground its margin is {signed(low)} to {signed(high)} ({level} % interval, {_p(block.p)})."


def _towards(found: RatioDifferenceItem, block: DifferenceItem) -> tuple[float, float]:
    """The interval of the better one's margin."""
    low, high = block.interval or (0.0, 0.0)
    return (low, high) if (found.difference or 0.0) >= 0 else (-high, -low)


def _elsewhere(found: RatioDifferenceItem) -> tuple[str, ...]:
    flip = found.sign_flip
    if flip is None:
        return ()
    if flip.smallest_p > 0.05:
        return (
            f"Of a new place it says nothing yet: over {flip.sequences} "
            f"sequence{'s' if flip.sequences != 1 else ''} no difference could have a p below {flip.smallest_p:g}.",
        )
    if flip.p <= 0.05:
        return (f"It holds over whole sequences too, so a new place would likely agree ({_p(flip.p)}).",)
    return (f"Whether it would hold in a new place is open: over whole sequences {_p(flip.p)}.",)


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
        _span(found.block, differences),
        _span(found.sequence, differences),
    )


def _span(found: DifferenceItem | None, axis: Axis) -> DifferenceSpan | None:
    if found is None or found.interval is None:
        return None
    low, high = found.interval
    return DifferenceSpan(axis.at(low), axis.width(high, low), f"{signed(low)} to {signed(high)}, {_p(found.p)}")


def _ends(found: RatioDifferenceItem) -> tuple[float, ...]:
    kinds = (kind.interval for kind in (found.block, found.sequence) if kind is not None)
    return tuple(end for interval in kinds if interval is not None for end in interval)
