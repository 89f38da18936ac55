"""Colours and names of the traversability classes in pictures.

**Conventions.** sRGB, 8 bits. The classes' colours differ in lightness too, so they survive grey printing and red-green
blindness.
"""

CLASS_RGB = {1: (38, 166, 91), 2: (250, 205, 80), 3: (176, 42, 55)}
CLASS_NAME = {1: "traversable", 2: "potentially traversable", 3: "non-traversable"}
PAPER, INK, TRACK, UNSEEN = (250, 250, 248), (30, 34, 40), (25, 70, 190), (206, 206, 202)
