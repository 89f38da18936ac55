"""Colours and names of the traversability classes in pictures.

**Conventions.** sRGB, 8 bits. The palette "default" is told apart by everybody: any two classes are CIEDE2000 ≥ 42 from
each other in normal sight and under simulated protanopia, deuteranopia and tritanopia. The palette "paper" has the
green, yellow and red of the STONE paper's figures, of which deuteranopia leaves CIEDE2000 14.8 between T and N; it is a
reader's choice, never the default. `TRACK` is near black, since it lies mostly on T.

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
    """`#2482e0` of an sRGB colour of 8 bits."""
    return "#{:02x}{:02x}{:02x}".format(*rgb)
