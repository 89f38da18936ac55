"""Places for the names on a drawing, so that no two stand on each other.

**Conventions.** In the drawing's own unit; a letter and a line are shares of its side. The first name gets the nearest
place, so who comes first is best placed.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

LETTER_RATIO, LINE_RATIO = 0.0165, 0.036
# Where a name is tried around its place: so many directions, on rings that grow by a line.
DIRECTIONS, RINGS = 16, 8


@dataclass(frozen=True)
class Label:
    """A name and what it is of."""

    text: str
    at: tuple[float, float]


def spread(labels: list[Label], side: float) -> list[tuple[Label, tuple[float, float]]]:
    """The middle of each name's text, on a drawing `side` wide; where there is no room, the last place tried."""
    boxes = [(*label.at, LINE_RATIO * side / 2, LINE_RATIO * side / 2) for label in labels]
    placed = list[tuple[Label, tuple[float, float]]]()
    centre = np.mean([label.at for label in labels], axis=0) if labels else np.zeros(2)
    for label in labels:
        half = (LETTER_RATIO * side * len(label.text) / 2, LINE_RATIO * side / 2)
        middle = label.at
        for right, up in _around(np.asarray(label.at) - centre):
            middle = (
                label.at[0] + right * (half[0] + LINE_RATIO * side),
                label.at[1] + up * LINE_RATIO * side,
            )
            if not any(_overlap((*middle, *half), box) for box in boxes):
                break
        boxes.append((*middle, *half))
        placed.append((label, middle))
    return placed


def _around(outward: NDArray[np.float64]) -> list[tuple[float, float]]:
    """Directions, nearest ring first, on each of them outward first; up where nothing is outward."""
    first = np.arctan2(outward[1], outward[0]) if np.hypot(*outward) > 0 else np.pi / 2
    steps = np.arange(DIRECTIONS)
    turns = first + np.where(steps % 2, -1, 1) * ((steps + 1) // 2) * 2 * np.pi / DIRECTIONS
    return [
        (float(np.cos(turn)) * min(ring, 2), float(np.sin(turn)) * (0.7 + ring))
        for ring in range(1, RINGS + 1)
        for turn in turns
    ]


def _overlap(a: tuple[float, float, float, float], b: tuple[float, float, float, float]) -> bool:
    """Of boxes as middle and half sides."""
    return abs(a[0] - b[0]) < a[2] + b[2] and abs(a[1] - b[1]) < a[3] + b[3]
