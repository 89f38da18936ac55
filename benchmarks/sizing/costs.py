"""Costs that grow with the frames: measured at two sizes, extrapolated to any.

**Conventions.** A cost is a number by its name: `CPU s`, `database rows`, `labels MB`. Two sizes give the fixed cost
and the cost per frame; no other model is fitted.
"""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class MeasuredCosts:
    """The costs of one object with this number of frames."""

    frames: int
    costs: Mapping[str, float]


@dataclass(frozen=True)
class CostLine:
    """Costs of one object: `once[what] + frames * each_frame[what]`."""

    once: Mapping[str, float]
    each_frame: Mapping[str, float]

    def of(self, frames: float, things: float = 1.0) -> Mapping[str, float]:
        """Return the costs of `things` objects with `frames` frames together."""
        return {what: things * self.once[what] + frames * self.each_frame[what] for what in self.once}


def line_through(small: MeasuredCosts, large: MeasuredCosts) -> CostLine:
    """Return the line through two sizes; a negative fixed cost becomes 0.

    Raises `ValueError` if the second has no more frames than the first.
    """
    further = large.frames - small.frames
    if further <= 0:
        raise ValueError(f"{large.frames} frames are not more than {small.frames}: no line goes through one size")
    counted = dict.fromkeys([*small.costs, *large.costs])
    each = {what: (large.costs.get(what, 0.0) - small.costs.get(what, 0.0)) / further for what in counted}
    once = {what: max(0.0, small.costs.get(what, 0.0) - each[what] * small.frames) for what in counted}
    return CostLine(once, each)
