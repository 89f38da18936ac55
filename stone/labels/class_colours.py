"""Colours and names of the traversability classes in images.

**Conventions.** sRGB, 8 bits. The palette "default" is colour-blind safe: the CIEDE2000 difference of any two classes
is ≥ 42 in normal vision and under simulated protanopia, deuteranopia and tritanopia. The palette "paper" has the green,
yellow and red of the STONE paper's figures, where deuteranopia leaves a CIEDE2000 of 14.8 between T and N; it is never
the default. `TRACK` is near black, because the track lies mostly on T.

Source: Machado, Oliveira and Fernandes 2009 (simulated colour vision); Sharma, Wu and Dalal 2005 (CIEDE2000);
`tests/stone/labels/test_class_colours.py` computes both.
"""

from collections.abc import Mapping
from typing import Literal

Rgb = tuple[int, int, int]
ColourName = Literal["default", "paper"]

PALETTES: Mapping[ColourName, Mapping[int, Rgb]] = {
    "default": {1: (36, 130, 224), 2: (244, 230, 71), 3: (154, 59, 56)},
    "paper": {1: (38, 166, 91), 2: (250, 205, 80), 3: (176, 42, 55)},
}
CLASS_RGB = PALETTES["default"]
CLASS_NAME = {1: "traversable", 2: "potentially traversable", 3: "non-traversable"}
PAPER, INK, TRACK, UNSEEN = (250, 250, 248), (30, 34, 40), (16, 20, 26), (206, 206, 202)


def hex_of(rgb: Rgb) -> str:
    """Return an 8-bit sRGB colour as `#2482e0`."""
    return "#{:02x}{:02x}{:02x}".format(*rgb)
