"""One common axis for figures whose rows stand below each other: round ticks, and where on it a value lies.

**Conventions.** Places are per cent of the figure's width, as SVG attributes take them (`12.5%`), so that a figure is
as wide as its place on the page without being stretched. The ends keep a margin for what is drawn around a value.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from math import ceil, floor, log10

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
        """The position of the value, in per cent of the width; what is outside lies at the end."""
        inside = min(max(value, self.low), self.high)
        return MARGIN + (100 - 2 * MARGIN) * (inside - self.low) / (self.high - self.low)

    def at(self, value: float) -> str:
        return f"{self.place(value):.2f}%"

    def width(self, value: float, base: float | None = None) -> str:
        """The length of the bar from `base` (the lower end where none is given) to the value."""
        return f"{abs(self.place(value) - self.place(self.low if base is None else base)):.2f}%"

    @property
    def ticks(self) -> tuple[AxisTick, ...]:
        count = round((self.high - self.low) / self.step)
        values = (round(self.low + number * self.step, 10) for number in range(count + 1))
        return tuple(AxisTick(value, self.at(value)) for value in values)


def axis_over(values: Iterable[float | None]) -> Axis:
    """An axis of ratios in [0, 1] that shows all of these closely; from 0 to 1 where there is none."""
    known = [value for value in values if value is not None]
    if not known:
        return Axis(0.0, 1.0, 0.2)
    low, high = max(0.0, min(known)), min(1.0, max(known))
    lacking = max(0.0, NARROWEST - (high - low)) / 2
    return _rounded(max(0.0, low - lacking), min(1.0, high + lacking))


def axis_from_zero(values: Iterable[float | None]) -> Axis:
    """An axis of ratios from 0 to a round value that none of these passes, for bars."""
    return axis_over([0.0, *values])


def axis_around_zero(values: Iterable[float | None]) -> Axis:
    """An axis as far to the left of 0 as to the right, for differences."""
    furthest = max((abs(value) for value in values if value is not None), default=0.0)
    step = _round_step(max(furthest, LEAST_REACH), 2)
    reach = step * ceil(max(furthest, step) / step - 1e-9)
    return Axis(-reach, reach, step)


def _rounded(low: float, high: float) -> Axis:
    step = _round_step(high - low, MOST_STEPS)
    return Axis(step * floor(low / step + 1e-9), step * ceil(high / step - 1e-9), step)


def _round_step(span: float, steps: int) -> float:
    """The least round number of which `steps` reach over the span."""
    rough = span / steps
    power = 10.0 ** floor(log10(rough))
    return float(next(factor * power for factor in ROUND if factor * power >= rough * (1 - 1e-9)))
