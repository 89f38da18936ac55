"""Scales and their ticks: positions of values on an axis, and its labelled values.

**Conventions.** A scale maps [low, high] to [start, end]; for y, which grows down in SVG, start is the larger. Values
beyond the ends are placed at the end. Ticks are 1, 2 or 5 times a power of ten (Heckbert, "Nice numbers for graph
labels", Graphics Gems 1990). On a signed logarithmic scale they are powers of ten of either sign, and zero.
"""

from dataclasses import dataclass
from math import ceil, floor, isfinite, log10

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
LEAST_SPAN, TINIEST = 1e-9, 1e-300


@dataclass(frozen=True)
class Scale:
    """A scale of values; with `linear_below` logarithmic beyond ± that value, and linear between (as asinh)."""

    low: float
    high: float
    start: float
    end: float
    linear_below: float = 0.0

    def at(self, values: Floats) -> Floats:
        """Return the positions of the values; NaN stays NaN. An axis without length places all in its middle."""
        low, high = self._bent(np.array([self.low, self.high]))
        if high <= low:
            return np.where(np.isnan(values), np.nan, (self.start + self.end) / 2)
        share = np.clip((self._bent(values) - low) / (high - low), 0.0, 1.0)
        return np.asarray(self.start + share * (self.end - self.start))

    def one(self, value: float) -> float:
        """Return the position of one value."""
        return float(self.at(np.array([value]))[0])

    def _bent(self, values: Floats) -> Floats:
        return np.arcsinh(values / self.linear_below) if self.linear_below else values


def nice_step(span: float, most: int) -> float:
    """Return the smallest 1, 2 or 5 × 10ⁿ that divides a span into at most `most` steps; 1 for no span."""
    least = span / most
    if not isfinite(least) or least < TINIEST:
        return 1.0
    magnitude = 10.0 ** floor(log10(least))
    return next(step * magnitude for step in (1.0, 2.0, 5.0, 10.0) if step * magnitude >= least * (1 - 1e-9))


def nice_ends(low: float, high: float, most: int = 5) -> tuple[float, float]:
    """Return the ticks around [low, high]; a span indistinguishable from zero is widened."""
    if high - low <= LEAST_SPAN * max(1.0, abs(low), abs(high)):
        width = max(abs(low) * 0.1, 1e-3)
        low, high = low - width, high + width
    step = nice_step(high - low, most)
    return floor(low / step + 1e-9) * step, ceil(high / step - 1e-9) * step


def ticks(low: float, high: float, most: int = 5) -> list[float]:
    """Return the nice values within [low, high], ascending, at most `most` + 1."""
    step = nice_step(high - low, most)
    first, last = ceil(low / step - 1e-9), floor(high / step + 1e-9)
    return [count * step for count in range(first, last + 1)]


def signed_log_ticks(low: float, high: float, linear_below: float) -> list[float]:
    """Return … −10, −1, 0, 1, 10 … in multiples of `linear_below` within [low, high], or every second of many."""
    decades = max(1, ceil(log10(max(abs(low), abs(high), linear_below) / linear_below) + 1e-9))
    each = max(1, ceil(decades / 4))
    sizes = [linear_below * 10.0**power for power in range(decades, -1, -each)]
    ticks_around_zero = [-size for size in sizes] + [0.0] + sizes[::-1]
    return [value for value in ticks_around_zero if low <= value <= high]


def tick_text(value: float, step: float) -> str:
    """Return the value with as many decimals as its step, a real minus sign and thousands separators."""
    decimals = max(0, -floor(log10(step) + 1e-9)) if step > 0 else 0
    text = f"{abs(value):,.{decimals}f}"
    return f"−{text}" if value < 0 and float(text.replace(",", "")) else text


def duration_text(value_ns: float) -> str:
    """Return a signed time in a suitable unit, at most three digits: `12 ms`, `−37 s`."""
    for size_ns, unit in ((1e9, "s"), (1e6, "ms"), (1e3, "µs")):
        if abs(value_ns) >= size_ns * 0.9995:
            text = f"{abs(value_ns) / size_ns:.3g}"
            text = text if "e" not in text else f"{abs(value_ns) / size_ns:,.0f}"
            return f"{'−' if value_ns < 0 else ''}{text} {unit}"
    return f"{'−' if value_ns < 0 else ''}{abs(value_ns):.0f} ns"
