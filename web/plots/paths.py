"""Points as path data: lines with gaps at unknown values, dots, filled bands.

**Conventions.** x ascends. NaN in y breaks a line. Coordinates are written to a tenth of a unit.
"""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
MOST_COLUMNS = 500


def line(x: Floats, y: Floats) -> str:
    """Return `M x y L …`, thinned to the visible detail; empty for no points. A single point is a dot (round caps)."""
    return " ".join(_run(*thinned(x[start:stop], y[start:stop])) for start, stop in known_runs(y))


def dots(x: Floats, y: Floats) -> str:
    """Return a stroke without length at each known point: with round caps a dot, however the plot is stretched."""
    return " ".join(f"M{_format(a)} {_format(b)}h0" for a, b in zip(x, y, strict=True) if not np.isnan(b))


def band(x: Floats, lower: Floats, upper: Floats) -> str:
    """Return the closed area between two lines over the same x; empty for fewer than two points."""
    if len(x) < 2:
        return ""
    there = [f"{_format(a)} {_format(b)}" for a, b in zip(x, upper, strict=True)]
    back = [f"{_format(a)} {_format(b)}" for a, b in zip(x[::-1], lower[::-1], strict=True)]
    return f"M{'L'.join(there)}L{'L'.join(back)}Z"


def known_runs(y: Floats) -> list[tuple[int, int]]:
    """Return (first, after the last) of each run without NaN."""
    is_known = np.concatenate([[False], ~np.isnan(y), [False]]).astype(np.int8)
    edges = np.flatnonzero(np.diff(is_known))
    return [(int(start), int(stop)) for start, stop in zip(edges[::2], edges[1::2], strict=True)]


def thinned(x: Floats, y: Floats, columns: int = MOST_COLUMNS) -> tuple[Floats, Floats]:
    """Return the first, lowest, highest and last point of each of `columns` even columns: the line looks the same.

    As M4 (Jugel et al., VLDB 2014). Few points are returned unchanged.
    """
    if len(x) <= 4 * columns:
        return x, y
    edges = np.searchsorted(x, np.linspace(x[0], x[-1], columns + 1)[1:-1])
    kept: set[int] = set()
    for start, stop in pairwise([0, *edges.tolist(), len(x)]):
        if start < stop:
            part = y[start:stop]
            kept |= {start, start + int(np.argmin(part)), start + int(np.argmax(part)), stop - 1}
    rows = np.array(sorted(kept))
    return x[rows], y[rows]


def _run(x: Floats, y: Floats) -> str:
    if len(x) == 1:
        return f"M{_format(x[0])} {_format(y[0])}h0"
    return "M" + "L".join(f"{_format(a)} {_format(b)}" for a, b in zip(x, y, strict=True))


def _format(value: float) -> str:
    text = f"{value:.1f}"
    return text.removesuffix(".0") if text != "-0.0" else "0"
