"""Bars along the recording's time, drawn by hand: they stretch to whatever width the page has.

**Conventions.** x is 0 to 1000 over the recording, y 0 to 10. The SVG is decoration: what it says stands beside it in
words or numbers.
"""

from collections.abc import Sequence

WIDTH, HEIGHT = 1000, 10
_BOX = f'viewBox="0 0 {WIDTH} {HEIGHT}" preserveAspectRatio="none"'
_SVG = f'<svg class="strip" {_BOX} aria-hidden="true" focusable="false">'


def cover_strip(covered: Sequence[float], gaps: Sequence[tuple[float, float]]) -> str:
    """Bins filled as far as they are covered; `gaps` are (start, end) as shares of the recording, marked in red."""
    bars = [f'<rect class="rail" width="{WIDTH}" height="{HEIGHT}"/>']
    for start, end, share in _runs(covered):
        shade = f' opacity="{share:.2f}"' if share < 1 else ""
        bars.append(_bar("cover", start / len(covered), end / len(covered), shade))
    bars += [_bar("gap", start, end, "") for start, end in gaps]
    return f"{_SVG}{''.join(bars)}</svg>"


def span_strip(first: float, last: float) -> str:
    """From the first to the last message of a topic that keeps no period, as shares of the recording."""
    return f'{_SVG}<rect class="rail" width="{WIDTH}" height="{HEIGHT}"/>{_bar("loose", first, last, "")}</svg>'


def word_strip(at: Sequence[float], swatches: Sequence[str]) -> str:
    """Consecutive samples of one swatch as one bar, each lasting to the next sample; `at` are shares, ascending."""
    ends = [*at[1:], 1.0]
    bars: list[str] = []
    start = 0
    for place, swatch in enumerate(swatches):
        if place + 1 == len(swatches) or swatches[place + 1] != swatch:
            bars.append(_bar(swatch, at[start], ends[place], ""))
            start = place + 1
    return f'{_SVG}<rect class="rail" width="{WIDTH}" height="{HEIGHT}"/>{"".join(bars)}</svg>'


def _bar(swatch: str, start: float, end: float, more: str) -> str:
    """At least 2 of the 1000 wide, so that it is seen."""
    left = min(max(0.0, start), 1.0) * WIDTH
    width = max(2.0, min(max(0.0, end), 1.0) * WIDTH - left)
    return f'<rect class="{swatch}" x="{left:.1f}" width="{width:.1f}" height="{HEIGHT}"{more}/>'


def _runs(covered: Sequence[float]) -> list[tuple[int, int, float]]:
    """(first bin, bin after the last, share) of equal neighbours; empty bins are left out."""
    runs: list[tuple[int, int, float]] = []
    for place, share in enumerate(round(value, 2) for value in covered):
        if runs and runs[-1][1] == place and runs[-1][2] == share:
            runs[-1] = (runs[-1][0], place + 1, share)
        elif share > 0:
            runs.append((place, place + 1, share))
    return runs
