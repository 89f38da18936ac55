"""Colours of surfaces: grass, soil, gravel, rock, bark, leaves, masonry, clothes and paint.

**Conventions.** A colour (N, 3) is the share of light that is reflected, red, green, blue, linear, 0 to 1: a function
of the place, the surface's normal and the pixel's footprint, so that any camera at any time sees one place alike.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulator.appearance.noise import Floats, cell_values, plane_fractal, single, space_fractal, stones, visible
from stone.geometry.se3 import Array

Rgb = tuple[float, float, float]
COURSE_M, BLOCK_M, JOINT_M = 0.22, 0.46, 0.016
STONE_M, PEBBLE_M = 0.16, 0.06
TIP_M = 0.3


@dataclass(frozen=True, eq=False)
class Spots:
    """Places on surfaces (N, 3), map frame, their normals (N, 3), heights above the ground and footprints (N,)."""

    points: Floats
    normals: Floats
    up_m: Floats
    footprint_m: Floats

    @property
    def xy(self) -> Floats:
        return self.points[:, :2]

    def of(self, where: NDArray[np.int64]) -> "Spots":
        """Some of them."""
        return Spots(self.points[where], self.normals[where], self.up_m[where], self.footprint_m[where])

    def noise(self, wavelength_m: float, octaves: int, layer: int) -> Floats:
        """In space (N,)."""
        return space_fractal(self.points, wavelength_m, octaves, self.footprint_m, layer)

    def plane_noise(self, wavelength_m: float, octaves: int, layer: int) -> Floats:
        """In plan (N,)."""
        return plane_fractal(self.xy, wavelength_m, octaves, self.footprint_m, layer)


def grass(spots: Spots, tall: Floats) -> Floats:
    """A meadow with drier patches; tall grass (0 to 1) is straw, and its tufts are dark at their feet."""
    dry = np.clip(0.25 + 1.1 * spots.plane_noise(6.0, 3, 11) + 0.5 * tall, 0, 1)
    tufts, blades = spots.plane_noise(0.7, 4, 17), spots.plane_noise(0.05, 3, 19)
    shade = 1 + (0.8 + 0.5 * tall) * tufts + (1.1 + 0.5 * tall) * blades
    return _tinted(_mixed((0.052, 0.098, 0.018), (0.170, 0.150, 0.050), dry), shade)


def soil(spots: Spots) -> Floats:
    """Trodden brown earth, damp in places, with a few pebbles."""
    shade = 1 + 0.9 * spots.plane_noise(2.4, 3, 31) + 1.1 * spots.plane_noise(0.24, 5, 37)
    earth = _tinted((0.165, 0.108, 0.064), shade)
    shown = visible(PEBBLE_M, spots.footprint_m)
    inside, tone = stones(spots.xy, PEBBLE_M, 41)
    pebble = np.clip(4 * inside - 1.2 - tone, 0, 1) * np.clip(4 * tone - 2.4, 0, 1) * shown
    return _mixed(earth, (0.19, 0.165, 0.135), 0.7 * pebble)


def gravel(spots: Spots) -> Floats:
    """Grey stones of two sizes with dark gaps."""
    shade = 1 + 0.6 * spots.plane_noise(1.8, 3, 43) + 0.7 * spots.plane_noise(0.1, 3, 45)
    for size_m, layer, depth in ((STONE_M, 47, 0.75), (PEBBLE_M, 53, 0.45)):
        inside, tone = stones(spots.xy, size_m, layer)
        shade *= 1 + depth * visible(size_m, spots.footprint_m) * (np.sqrt(inside) - 0.68 + 0.45 * tone)
    return _tinted((0.195, 0.178, 0.152), shade)


def rock(spots: Spots) -> Floats:
    """Grey rock in tilted layers, with cracks and lichen."""
    coarse = spots.noise(1.6, 3, 61)
    x, _, z = spots.points.T
    layers = np.sin(13.0 * (z + 0.3 * x + 1.4 * coarse)) * visible(0.4, spots.footprint_m)
    shade = 1 + 0.7 * coarse + 1.2 * spots.noise(0.45, 5, 67) + 0.12 * layers
    flat = spots.points * single((1.0, 1.0, 0.6))
    crack = np.abs(space_fractal(flat, 1.1, 4, spots.footprint_m, 71))
    shade *= 1 - 0.7 * np.clip(1 - crack / 0.015, 0, 1) * np.clip(6 * coarse, 0, 1) * visible(0.12, spots.footprint_m)
    lichen = np.clip(5 * spots.noise(0.8, 4, 79) - 1.3, 0, 0.55)
    return _mixed(_tinted((0.185, 0.172, 0.155), shade), (0.165, 0.17, 0.07), lichen)


def bark(spots: Spots) -> Floats:
    """Brown bark, furrowed along the trunk."""
    along = spots.points * single((1.0, 1.0, 0.12))
    shade = 1 + 2.0 * space_fractal(along, 0.08, 4, spots.footprint_m, 83) + 0.9 * spots.noise(0.6, 3, 89)
    return _tinted((0.098, 0.070, 0.047), shade)


def bush(spots: Spots) -> Floats:
    """Light leaves; a plant's tint is its own."""
    return _leaves(spots, (0.060, 0.105, 0.022))


def crown(spots: Spots) -> Floats:
    """Darker leaves."""
    return _leaves(spots, (0.040, 0.080, 0.020))


def _leaves(spots: Spots, colour: Rgb) -> Floats:
    ripe = np.clip(0.4 + 1.4 * spots.plane_noise(5.0, 2, 97), 0, 1)
    shade = 1 + 1.5 * spots.noise(0.3, 4, 101)
    return _tinted(_mixed(colour, (colour[0] * 2.0, colour[1] * 1.25, colour[2]), ripe), shade)


def blade(spots: Spots) -> Floats:
    """Blades of grass: dark at their feet, straw at their tips."""
    tip = np.clip(spots.up_m / np.float32(TIP_M), 0, 1)
    shade = 0.8 + 0.4 * tip + 0.5 * spots.plane_noise(0.05, 2, 103)
    return _tinted(_mixed((0.075, 0.125, 0.025), (0.220, 0.195, 0.080), tip), shade)


def masonry(spots: Spots) -> Floats:
    """Courses of hewn stone with light joints on the faces of a wall, a slab on its top."""
    x, y, z = spots.points.T
    level = np.hypot(spots.normals[:, 0], spots.normals[:, 1])
    along = (y * spots.normals[:, 0] - x * spots.normals[:, 1]) / np.maximum(level, 1e-6)
    course = np.floor(z / COURSE_M)
    across = along / BLOCK_M + 0.5 * (course % 2)
    stone = np.floor(across)
    tone = cell_values(course.astype(np.int64), stone.astype(np.int64), 127) * visible(BLOCK_M, spots.footprint_m)
    shade = 1 + np.where(level > 0.5, 0.30 * tone, 0) + 1.1 * spots.noise(0.3, 5, 131)
    edge_m = np.maximum(
        np.abs(across - stone - 0.5) * BLOCK_M - BLOCK_M / 2, np.abs(z % COURSE_M - COURSE_M / 2) - COURSE_M / 2
    )
    width_m = np.maximum(JOINT_M, spots.footprint_m)
    joint = np.clip(1.5 + edge_m / width_m, 0, 1) * np.minimum(1, JOINT_M / width_m) * (level > 0.5)
    return _mixed(_tinted((0.215, 0.180, 0.140), shade), (0.31, 0.295, 0.265), joint)


def clothes(spots: Spots) -> Floats:
    """A walker: dark trousers, an orange jacket with a band that reflects, a head."""
    trousers, jacket, band, face, hair = (
        (0.035, 0.04, 0.06),
        (0.50, 0.10, 0.02),
        (0.65, 0.65, 0.60),
        (0.36, 0.22, 0.16),
        (0.05, 0.035, 0.025),
    )
    return _banded(spots.up_m, (0.85, 1.05, 1.12, 1.48, 1.66), (trousers, jacket, band, jacket, face, hair))


def paint(spots: Spots) -> Floats:
    """A vehicle: a dark underside, blue doors, a band of windows, a roof."""
    return _banded(
        spots.up_m, (0.5, 1.0, 1.42), ((0.02, 0.02, 0.02), (0.04, 0.09, 0.28), (0.03, 0.035, 0.04), (0.04, 0.09, 0.28))
    )


def _banded(up_m: Floats, limits_m: tuple[float, ...], colours: tuple[Rgb, ...]) -> Floats:
    return np.asarray(colours, np.float32)[np.searchsorted(limits_m, up_m)]


def _mixed(low: Rgb | Floats, high: Rgb, share: Array | Floats) -> Floats:
    """From one colour, or one for each spot (N, 3), to another by share (N,)."""
    begin = np.asarray(low, np.float32)
    return begin + share.astype(np.float32)[:, None] * (single(high) - begin)


def _tinted(colour: Rgb | Floats, shade: Array | Floats) -> Floats:
    """A colour, or one for each spot (N, 3), darkened or lightened by shade (N,), which is kept above black."""
    return np.asarray(colour, np.float32) * np.maximum(shade, 0.12).astype(np.float32)[:, None]
