"""Numbers as SVG: scales, paths and plots as plain strings that templates insert.

**Conventions.** Pure: numbers in, frozen values of numbers and path strings out; no external names enter a path. A plot
is `WIDTH` units wide and as many units high as pixels. It is stretched to its column (`preserveAspectRatio="none"`,
with strokes that do not scale). Its words stand beside it at their own size, so that they are readable on a phone.
"""
