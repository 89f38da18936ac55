"""Comparison of two leaderboard entries, as figures and in words.

**Conventions.** Differences are percentage points, a − b; the words describe the better entry. A difference is
significant if the two-sided p for these sequences is at most 1 − the level of the intervals. The test over whole
sequences, which covers unseen places, is shown separately. If a test is impossible, the page shows the reason.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from math import ceil, floor, log10

from api.schemas.leaderboard import ComparisonAnswer, DifferenceItem, RatioDifferenceItem
from stone.scoring.intervals import SILENCES, Scope

# One common axis for figures whose rows stand below each other: round ticks, and where on it a value lies.
#
# **Conventions.** Places are per cent of the figure's width, as SVG attributes take them (`12.5%`), so that a figure
# is as wide as its place on the page without being stretched. The ends keep a margin for what is drawn around a value.


MARGIN = 4.0
MOST_STEPS = 5
NARROWEST = 0.02
LEAST_REACH = 0.001
ROUND = (1.0, 2.0, 2.5, 5.0, 10.0)


@dataclass(frozen=True)
class AxisTick:
    """A value that is named on the axis, and where."""

    value: float
    at: str


@dataclass(frozen=True)
class Axis:
    """An axis from `low` to `high`, both round multiples of `step`."""

    low: float
    high: float
    step: float

    def place(self, value: float) -> float:
        """Return the position of the value, in per cent of the width; values outside are placed at the end."""
        inside = min(max(value, self.low), self.high)
        return MARGIN + (100 - 2 * MARGIN) * (inside - self.low) / (self.high - self.low)

    def at(self, value: float) -> str:
        return f"{self.place(value):.2f}%"

    def width(self, value: float, base: float | None = None) -> str:
        """Return the length of the bar from `base` (default: the lower end) to the value."""
        return f"{abs(self.place(value) - self.place(self.low if base is None else base)):.2f}%"

    @property
    def ticks(self) -> tuple[AxisTick, ...]:
        count = round((self.high - self.low) / self.step)
        values = (round(self.low + number * self.step, 10) for number in range(count + 1))
        return tuple(AxisTick(value, self.at(value)) for value in values)


def axis_over(values: Iterable[float | None]) -> Axis:
    """Return an axis that shows these ratios in [0, 1] closely; from 0 to 1 without values."""
    known = [value for value in values if value is not None]
    if not known:
        return Axis(0.0, 1.0, 0.2)
    low, high = max(0.0, min(known)), min(1.0, max(known))
    lacking = max(0.0, NARROWEST - (high - low)) / 2
    return _rounded(max(0.0, low - lacking), min(1.0, high + lacking))


def axis_from_zero(values: Iterable[float | None]) -> Axis:
    """Return an axis of ratios from 0 to a round value above all of them, for bars."""
    return axis_over([0.0, *values])


def axis_around_zero(values: Iterable[float | None]) -> Axis:
    """Return an axis symmetric around 0, for differences."""
    furthest = max((abs(value) for value in values if value is not None), default=0.0)
    step = _round_step(max(furthest, LEAST_REACH), 2)
    reach = step * ceil(max(furthest, step) / step - 1e-9)
    return Axis(-reach, reach, step)


def _rounded(low: float, high: float) -> Axis:
    step = _round_step(high - low, MOST_STEPS)
    return Axis(step * floor(low / step + 1e-9), step * ceil(high / step - 1e-9), step)


def _round_step(span: float, steps: int) -> float:
    """Return the smallest round step that covers the span in at most `steps` steps."""
    rough = span / steps
    power = 10.0 ** floor(log10(rough))
    return float(next(factor * power for factor in ROUND if factor * power >= rough * (1 - 1e-9)))


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
    text: str


@dataclass(frozen=True)
class ComparedRow:
    """One ratio of both: widths of the bars, and where the difference lies; null is undefined or not shown."""

    name: str
    title: str
    ratio: RatioDifferenceItem
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
    bars = axis_from_zero(value for ratio in ratios.values() for value in (ratio.a, ratio.b))
    reach = [value for ratio in ratios.values() for value in (ratio.difference, *_ends(ratio))]
    differences = axis_around_zero(reach)
    rows = tuple(_row(name, ratios[name], bars, differences) for name in TITLES)
    return ComparisonFigures(rows, bars, differences, verdict(answer, names))


def verdict(answer: ComparisonAnswer, names: Names) -> ComparisonVerdict:
    """Return the verdict in words: the better entry by mIoU, the margin, and its significance."""
    ratio = answer.ratios["miou"]
    if ratio.difference is None:
        return ComparisonVerdict(
            "The two entries cannot be ordered", ("One of the entries has no mIoU: a class is undefined.",)
        )
    better, worse = (names.a, names.b) if ratio.difference >= 0 else (names.b, names.a)
    margin = f"{better} is ahead by {abs(100 * ratio.difference):.2f} points of mIoU."
    if ratio.difference == 0:
        return ComparisonVerdict(f"{names.a} and {names.b} have the same mIoU", (_uncertain(answer, ratio),))
    if answer.is_withheld or ratio.these_places is None:
        headline = f"{better} is ahead of {worse}; significance unknown"
        scored = f"{better} scored {abs(100 * ratio.difference):.2f} points of mIoU more."
        return ComparisonVerdict(headline, (scored, _uncertain(answer, ratio)))
    grounds = (margin, _here(answer, ratio.difference, ratio.these_places), *_elsewhere(answer, ratio))
    if ratio.these_places.p > 1 - answer.interval_level:
        return ComparisonVerdict(f"No significant difference between {names.a} and {names.b}", grounds)
    return ComparisonVerdict(f"{better} is better than {worse}", grounds)


def signed(difference: float) -> str:
    """Return a difference as `+1.13`, in percentage points."""
    points = 100 * difference
    return f"{MINUS if points < 0 else '+'}{abs(points):.2f}"


def _uncertain(answer: ComparisonAnswer, found: RatioDifferenceItem) -> str:
    if answer.is_withheld:
        return "Significance is shown when the phase has ended: until then its ground truth is hidden."
    if found.these_places is None:
        return f"No significance test: {_silence(found, 'these_places')}."
    return _here(answer, found.difference or 0.0, found.these_places)


def _here(answer: ComparisonAnswer, difference: float, told: DifferenceItem) -> str:
    """Return the interval of the better entry's margin."""
    low, high = told.interval if difference >= 0 else (-told.interval[1], -told.interval[0])
    level = round(100 * answer.interval_level)
    return f"On these sequences the margin is {signed(low)} to {signed(high)} ({level} % interval, {_p(told.p)})."


def _elsewhere(answer: ComparisonAnswer, found: RatioDifferenceItem) -> tuple[str, ...]:
    interval = found.new_place
    if interval is None:
        return (f"No interval for unseen places: {_silence(found, 'new_place')}.",)
    if interval.p <= 1 - answer.interval_level:
        return (f"It is also significant across whole sequences and thus likely in unseen places ({_p(interval.p)}).",)
    return (f"It is not significant across whole sequences and may not hold in unseen places ({_p(interval.p)}).",)


def _silence(found: RatioDifferenceItem, scope: Scope) -> str:
    code = (found.silences or {}).get(scope)
    return "the reason is unknown" if code is None else SILENCES[code]


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
    return tuple(
        end for interval in (found.these_places, found.new_place) if interval is not None for end in interval.interval
    )
