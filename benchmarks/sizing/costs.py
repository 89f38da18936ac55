"""Costs that grow by the frame: measured at two sizes, told for any.

**Conventions.** A cost is a number by what is counted, all of one thing: `CPU s`, `database rows`, `labels MB`. Of two
sizes follow what each thing costs once and what each of its frames costs; nothing is fitted beyond them.
"""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class MeasuredCosts:
    """What one thing of so many frames cost."""

    frames: int
    costs: Mapping[str, float]


@dataclass(frozen=True)
class CostLine:
    """Costs of one thing: `once[what] + frames * each_frame[what]`."""

    once: Mapping[str, float]
    each_frame: Mapping[str, float]

    def of(self, frames: float, things: float = 1.0) -> Mapping[str, float]:
        """The costs of so many things that have so many frames together."""
        return {what: things * self.once[what] + frames * self.each_frame[what] for what in self.once}


def line_through(small: MeasuredCosts, large: MeasuredCosts) -> CostLine:
    """The line through two sizes; what would cost less than nothing once costs nothing.

    Raises `ValueError` where the second has no more frames than the first.
    """
    further = large.frames - small.frames
    if further <= 0:
        raise ValueError(f"{large.frames} frames are not more than {small.frames}: no line goes through one size")
    counted = dict.fromkeys([*small.costs, *large.costs])
    each = {what: (large.costs.get(what, 0.0) - small.costs.get(what, 0.0)) / further for what in counted}
    once = {what: max(0.0, small.costs.get(what, 0.0) - each[what] * small.frames) for what in counted}
    return CostLine(once, each)
