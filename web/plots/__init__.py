"""Numbers as SVG: scales, paths and plots as plain strings that templates put in place.

**Conventions.** Pure: numbers in, frozen values of numbers and path strings out; no names from outside enter a path. A
plot is `WIDTH` units wide and as many units high as pixels: it is stretched to its column (`preserveAspectRatio="none"`
with strokes that do not scale), and its words stand beside it at their own size, so they read well on a phone.
"""
