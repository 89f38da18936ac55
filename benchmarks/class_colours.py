"""Colour differences between the classes: `python -m benchmarks.class_colours`.

It prints CIEDE2000 of every pair of classes in normal vision and under simulated protanopia, deuteranopia and
tritanopia, in the page colours before and after 2026-11 (light and dark). It also prints the smallest difference of any
pair and vision if relief lights and shades the colours, and the difference to the background.
"""

from itertools import combinations

import numpy as np
from rich.console import Console
from rich.table import Table

from services.domain.viewer.frame_picture import LIGHTS
from services.labeler.previews.render import SHADE, SIDE_LIGHT
from stone.labels.class_colours import INK, PALETTES, PAPER, TRACK, UNSEEN, Rgb
from testing.colour_vision import VISIONS, difference, least_difference, least_of_pairs

EARLIER_DARK = [(61, 189, 114), (245, 207, 99), (217, 81, 94)]
EARLIER_TRACK = (25, 70, 190)
TRIPLES: dict[str, list[Rgb]] = {
    "before, light (the palette “paper” today)": list(PALETTES["paper"].values()),
    "before, dark": EARLIER_DARK,
    "after, light and dark (the palette “default”)": list(PALETTES["default"].values()),
}
LIGHT_RANGES = {
    "pictures from above, before": (0.64, 1.25),
    "pictures from above, after": (min(LIGHTS), max(LIGHTS)),
    "perspectives and films, before": (0.48, 1.0),
    "perspectives and films, after": (min(SIDE_LIGHT) * (1.0 - SHADE), max(SIDE_LIGHT)),
    "3D view, before": (0.46, 1.0),
    "3D view, after": (0.70, 0.98),
}
GROUNDS: dict[str, Rgb] = {
    "paper": PAPER,
    "never seen": UNSEEN,
    "dark page": (20, 23, 27),
    "track": TRACK,
    "track, before": EARLIER_TRACK,
    "robot": INK,
}
STEPS = 9


def main() -> None:
    console = Console()
    for table in (_pairs(), _lit(), _grounds()):
        console.print(table)


def _pairs() -> Table:
    table = Table(title="CIEDE2000 between classes")
    for column in ("colours", "vision", "T–P", "T–N", "P–N", "least"):
        table.add_column(column, justify="left" if column in ("colours", "vision") else "right")
    for name, triple in TRIPLES.items():
        for vision in VISIONS:
            distances = [difference(a, b, vision) for a, b in combinations(triple, 2)]
            table.add_row(
                name if vision == "normal" else "", vision, *(f"{x:.1f}" for x in (*distances, min(distances)))
            )
    return table


def _lit() -> Table:
    table = _by_triple("Least CIEDE2000 between classes in light and shade, any vision", "light")
    for name, (least, most) in LIGHT_RANGES.items():
        lights = np.linspace(least, most, STEPS)
        distances = (least_of_pairs(triple, lights) for triple in TRIPLES.values())
        table.add_row(f"{name} ({least:.2f}–{most:.2f})", *(f"{x:.1f}" for x in distances))
    return table


def _grounds() -> Table:
    title = "Least CIEDE2000 from what lies under or over a class, any vision (T / P / N)"
    table = _by_triple(title, "ground or mark")
    for name, ground in GROUNDS.items():
        distances = ([least_difference(colour, ground) for colour in triple] for triple in TRIPLES.values())
        table.add_row(name, *(" / ".join(f"{x:.0f}" for x in row) for row in distances))
    return table


def _by_triple(title: str, first: str) -> Table:
    """Return a table with a column for each triple of colours, without rows."""
    table = Table(title=title)
    table.add_column(first)
    for name in TRIPLES:
        table.add_column(name, justify="right")
    return table


if __name__ == "__main__":
    main()
