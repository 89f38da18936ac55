"""Bars along the recording's time: they stretch to whatever width the page has.

**Conventions.** x is 0 to 1000 over the recording. Bars are decoration: what they say stands beside them in words or
numbers.
"""

from collections.abc import Sequence
from dataclasses import dataclass

WIDTH = 1000


@dataclass(frozen=True)
class StripBar:
    """One bar: `swatch` is its class, `opacity` 0 to 1."""

    swatch: str
    x: float
    width: float
    opacity: float = 1.0


def cover_strip(covered: Sequence[float], gaps: Sequence[tuple[float, float]]) -> tuple[StripBar, ...]:
    """Bins filled as far as they are covered; `gaps` are (start, end) as shares of the recording, marked in red."""
    bars = [_bar("cover", start / len(covered), end / len(covered), share) for start, end, share in _runs(covered)]
    return (*bars, *(_bar("gap", start, end) for start, end in gaps))


def span_strip(first: float, last: float) -> tuple[StripBar, ...]:
    """From the first to the last message of a topic that keeps no period, as shares of the recording."""
    return (_bar("loose", first, last),)


def word_strip(at: Sequence[float], swatches: Sequence[str]) -> tuple[StripBar, ...]:
    """Consecutive samples of one swatch as one bar, each lasting to the next sample; `at` are shares, ascending."""
    ends = [*at[1:], 1.0]
    bars: list[StripBar] = []
    start = 0
    for place, swatch in enumerate(swatches):
        if place + 1 == len(swatches) or swatches[place + 1] != swatch:
            bars.append(_bar(swatch, at[start], ends[place]))
            start = place + 1
    return tuple(bars)


def _bar(swatch: str, start: float, end: float, opacity: float = 1.0) -> StripBar:
    """At least 2 of the 1000 wide, so that it is seen."""
    left = min(max(0.0, start), 1.0) * WIDTH
    return StripBar(swatch, left, max(2.0, min(max(0.0, end), 1.0) * WIDTH - left), opacity)


def _runs(covered: Sequence[float]) -> list[tuple[int, int, float]]:
    """(first bin, bin after the last, share) of equal neighbours; empty bins are left out."""
    runs: list[tuple[int, int, float]] = []
    for place, share in enumerate(round(value, 2) for value in covered):
        if runs and runs[-1][1] == place and runs[-1][2] == share:
            runs[-1] = (runs[-1][0], place + 1, share)
        elif share > 0:
            runs.append((place, place + 1, share))
    return runs
