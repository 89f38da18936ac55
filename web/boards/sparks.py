"""Sparklines: small SVG figures of counts."""

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class SparkBar:
    """A bar from the ground up, in the figure's own units; `count` is what it stands for."""

    x: float
    y: float
    width: float
    height: float
    count: int


def bars(counts: Sequence[int], width: float, height: float, gap: float = 1.0) -> list[SparkBar]:
    """A bar per count over `width` × `height`; the highest fills the height, none is a hair high."""
    most, step = max([1, *counts]), width / max(1, len(counts))
    heights = [max(1.0, height * count / most) for count in counts]
    return [
        SparkBar(round(place * step, 2), round(height - tall, 2), round(step - gap, 2), round(tall, 2), count)
        for place, (count, tall) in enumerate(zip(counts, heights, strict=True))
    ]
