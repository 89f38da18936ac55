"""Colours of surfaces: grass, soil, gravel, rock, bark, leaves, masonry, clothes and paint.

**Conventions.** A colour (N, 3) is the share of reflected light, red, green, blue, linear, 0 to 1. It is a function of
the position, the surface's normal and the pixel's footprint, so that a position looks the same to any camera at any
time.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simulator.scenery.terrain import Terrain, fractal
from simulator.scenery.world import MAX_SLOPE_RAD, drivability
from stone.geometry.se3 import Array

# Noise that is a function of position: values on integer lattices from a shuffled table, without state. Positions are
# in metres in the map frame, (N, 2) or (N, 3) float32. `footprint_m` (N,) is how much of the surface one pixel covers:
# an octave fades out as its wavelength falls from two footprints to one, below which it would only flicker. An octave's
# values lie in [−1, 1]; each next octave has half the wavelength and half the amplitude. So a sum lies in (−1, 1) with
# a deviation of about 0.2. Each layer is another noise; a layer repeats after 1,024 waves. Method: value noise on a
# permutation table (Perlin 1985, "An image synthesizer", sections 3 and 5).


Floats = NDArray[np.float32]
SIZE = 1024
_drawn = np.random.Generator(np.random.PCG64(1985))
_SHUFFLED = np.tile(_drawn.permutation(SIZE).astype(np.int32), 2)
_VALUES = np.tile(_drawn.permutation(np.linspace(-1, 1, SIZE)).astype(np.float32), 2)
_MASK = SIZE - 1
FIRST = np.float32(0.5)  # the amplitude of the first octave


def single(values: Sequence[float]) -> Floats:
    """Return the values in single precision, so that computations with them stay in it."""
    return np.array(values, np.float32)


def plane_fractal(xy: Floats, wavelength_m: float, octaves: int, footprint_m: Floats, layer: int) -> Floats:
    """Return the sum of octaves from `wavelength_m` down in the plane (N,), as far as each pixel resolves them."""
    result: Floats = _fractal(xy, wavelength_m, octaves, footprint_m, layer)
    return result


def space_fractal(points: Floats, wavelength_m: float, octaves: int, footprint_m: Floats, layer: int) -> Floats:
    """Return the sum of octaves in space (N,)."""
    result: Floats = _fractal(points, wavelength_m, octaves, footprint_m, layer)
    return result


def cell_values(i: NDArray[np.int64], j: NDArray[np.int64], layer: int) -> Floats:
    """Return a value in [−1, 1] for each cell of a lattice (N,), independent of its neighbours."""
    return np.asarray(_VALUES[_SHUFFLED[_SHUFFLED[(i + layer) & _MASK] + (j & _MASK)]])


def visible(wavelength_m: float, footprint_m: Floats) -> Floats:
    """Return the share of an octave that pixels of this footprint resolve (N,), 0 to 1."""
    return np.asarray(np.clip(np.float32(wavelength_m) / footprint_m - 1, 0, 1))


@njit(cache=True, nogil=True, error_model="numpy")
def _fractal(points, wavelength_m, octaves, footprint_m, layer):  # type: ignore[no-untyped-def]
    total = np.zeros(len(points), np.float32)
    for index in range(len(points)):
        amplitude, wavelength = FIRST, np.float32(wavelength_m)
        for octave in range(octaves):
            shown = wavelength / footprint_m[index] - np.float32(1)
            if shown <= 0:
                break
            shown = min(shown, np.float32(1))
            scale, start = 1 / wavelength, _SHUFFLED[(layer + octave) & _MASK]
            x, y = points[index, 0] * scale, points[index, 1] * scale
            if points.shape[1] == 2:
                value = _plane(x, y, start)
            else:
                z = points[index, 2] * scale
                low = math.floor(z)
                w = _eased(z - np.float32(low))
                value = _plane(x, y, _SHUFFLED[(start + low) & _MASK]) * (1 - w)
                value += _plane(x, y, _SHUFFLED[(start + low + 1) & _MASK]) * w
            total[index] += shown * amplitude * value
            amplitude, wavelength = amplitude * FIRST, wavelength * FIRST
    return total


@njit(cache=True, nogil=True)
def _plane(x, y, start):  # type: ignore[no-untyped-def]
    i, j = math.floor(x), math.floor(y)
    u, v = _eased(x - np.float32(i)), _eased(y - np.float32(j))
    left, right, row = _SHUFFLED[(start + i) & _MASK], _SHUFFLED[(start + i + 1) & _MASK], j & _MASK
    low = _VALUES[_SHUFFLED[left + row]] * (1 - u) + _VALUES[_SHUFFLED[right + row]] * u
    high = _VALUES[_SHUFFLED[left + row + 1]] * (1 - u) + _VALUES[_SHUFFLED[right + row + 1]] * u
    return low * (1 - v) + high * v


@njit(cache=True, nogil=True)
def _eased(ratio):  # type: ignore[no-untyped-def]
    return ratio * ratio * (np.float32(3) - np.float32(2) * ratio)


def stones(xy: Floats, size_m: float, layer: int) -> tuple[Floats, Floats]:
    """Return stones of about `size_m` strewn on the plane.

    The results are how far inside a stone each position is (N,), from 0 between stones to 1 at a centre, and the
    stone's tone (N,) in [−1, 1].
    """
    inside, tone = _stones(xy, np.float32(size_m), layer)
    return inside, tone


@njit(cache=True, nogil=True, error_model="numpy")
def _stones(xy, size_m, layer):  # type: ignore[no-untyped-def]
    inside, tone = np.zeros(len(xy), np.float32), np.zeros(len(xy), np.float32)
    for index in range(len(xy)):
        x, y = xy[index, 0] / size_m, xy[index, 1] / size_m
        column, row = math.floor(x), math.floor(y)
        nearest, chosen = np.float32(9), 0
        for i in range(column - 1, column + 2):
            for j in range(row - 1, row + 2):
                cell = _SHUFFLED[_SHUFFLED[(i + layer) & _MASK] + (j & _MASK)]
                dx = np.float32(i) + np.float32(0.5) + np.float32(0.4) * _VALUES[cell] - x
                dy = np.float32(j) + np.float32(0.5) + np.float32(0.4) * _VALUES[cell + 1] - y
                distance = dx * dx + dy * dy
                if distance < nearest:
                    nearest, chosen = distance, cell
        inside[index] = max(1 - nearest / np.float32(0.3), np.float32(0))
        tone[index] = _VALUES[chosen + 2]
    return inside, tone


Rgb = tuple[float, float, float]
COURSE_M, BLOCK_M, JOINT_M = 0.22, 0.46, 0.016
STONE_M, PEBBLE_M = 0.16, 0.06
TIP_M = 0.3


@dataclass(frozen=True, eq=False)
class Spots:
    """Positions on surfaces (N, 3), map frame, their normals (N, 3), heights above the ground and footprints (N,)."""

    points: Floats
    normals: Floats
    up_m: Floats
    footprint_m: Floats

    @property
    def xy(self) -> Floats:
        return self.points[:, :2]

    def of(self, where: NDArray[np.int64]) -> "Spots":
        """Return the spots with these indices."""
        return Spots(self.points[where], self.normals[where], self.up_m[where], self.footprint_m[where])

    def noise(self, wavelength_m: float, octaves: int, layer: int) -> Floats:
        """Return noise in space (N,)."""
        return space_fractal(self.points, wavelength_m, octaves, self.footprint_m, layer)

    def plane_noise(self, wavelength_m: float, octaves: int, layer: int) -> Floats:
        """Return noise in plan (N,)."""
        return plane_fractal(self.xy, wavelength_m, octaves, self.footprint_m, layer)


def grass(spots: Spots, tall: Floats) -> Floats:
    """Return a meadow with drier patches; tall grass (0 to 1) is straw-coloured, with tufts that are dark at their
    feet.
    """
    dry = np.clip(0.25 + 1.1 * spots.plane_noise(6.0, 3, 11) + 0.5 * tall, 0, 1)
    tufts, blades = spots.plane_noise(0.7, 4, 17), spots.plane_noise(0.05, 3, 19)
    shade = 1 + (0.8 + 0.5 * tall) * tufts + (1.1 + 0.5 * tall) * blades
    return _tinted(_mixed((0.052, 0.098, 0.018), (0.170, 0.150, 0.050), dry), shade)


def soil(spots: Spots) -> Floats:
    """Return trodden brown earth, damp in places, with a few pebbles."""
    shade = 1 + 0.9 * spots.plane_noise(2.4, 3, 31) + 1.1 * spots.plane_noise(0.24, 5, 37)
    earth = _tinted((0.165, 0.108, 0.064), shade)
    shown = visible(PEBBLE_M, spots.footprint_m)
    inside, tone = stones(spots.xy, PEBBLE_M, 41)
    pebble = np.clip(4 * inside - 1.2 - tone, 0, 1) * np.clip(4 * tone - 2.4, 0, 1) * shown
    return _mixed(earth, (0.19, 0.165, 0.135), 0.7 * pebble)


def gravel(spots: Spots) -> Floats:
    """Return grey stones of two sizes with dark gaps."""
    shade = 1 + 0.6 * spots.plane_noise(1.8, 3, 43) + 0.7 * spots.plane_noise(0.1, 3, 45)
    for size_m, layer, depth in ((STONE_M, 47, 0.75), (PEBBLE_M, 53, 0.45)):
        inside, tone = stones(spots.xy, size_m, layer)
        shade *= 1 + depth * visible(size_m, spots.footprint_m) * (np.sqrt(inside) - 0.68 + 0.45 * tone)
    return _tinted((0.195, 0.178, 0.152), shade)


def rock(spots: Spots) -> Floats:
    """Return grey rock in tilted layers, with cracks and lichen."""
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
    """Return brown bark, furrowed along the trunk."""
    along = spots.points * single((1.0, 1.0, 0.12))
    shade = 1 + 2.0 * space_fractal(along, 0.08, 4, spots.footprint_m, 83) + 0.9 * spots.noise(0.6, 3, 89)
    return _tinted((0.098, 0.070, 0.047), shade)


def bush(spots: Spots) -> Floats:
    """Return light leaves; each plant has its own tint."""
    return _leaves(spots, (0.060, 0.105, 0.022))


def crown(spots: Spots) -> Floats:
    """Return darker leaves."""
    return _leaves(spots, (0.040, 0.080, 0.020))


def _leaves(spots: Spots, colour: Rgb) -> Floats:
    ripe = np.clip(0.4 + 1.4 * spots.plane_noise(5.0, 2, 97), 0, 1)
    shade = 1 + 1.5 * spots.noise(0.3, 4, 101)
    return _tinted(_mixed(colour, (colour[0] * 2.0, colour[1] * 1.25, colour[2]), ripe), shade)


def blade(spots: Spots) -> Floats:
    """Return blades of grass: dark at their feet, straw-coloured at their tips."""
    tip = np.clip(spots.up_m / np.float32(TIP_M), 0, 1)
    shade = 0.8 + 0.4 * tip + 0.5 * spots.plane_noise(0.05, 2, 103)
    return _tinted(_mixed((0.075, 0.125, 0.025), (0.220, 0.195, 0.080), tip), shade)


def masonry(spots: Spots) -> Floats:
    """Return courses of hewn stone with light joints on the faces of a wall, a slab on its top."""
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
    """Return a walker: dark trousers, an orange jacket with a reflective band, a head."""
    trousers, jacket, band, face, hair = (
        (0.035, 0.04, 0.06),
        (0.50, 0.10, 0.02),
        (0.65, 0.65, 0.60),
        (0.36, 0.22, 0.16),
        (0.05, 0.035, 0.025),
    )
    return _banded(spots.up_m, (0.85, 1.05, 1.12, 1.48, 1.66), (trousers, jacket, band, jacket, face, hair))


def paint(spots: Spots) -> Floats:
    """Return a vehicle: a dark underside, blue doors, a band of windows, a roof."""
    return _banded(
        spots.up_m, (0.5, 1.0, 1.42), ((0.02, 0.02, 0.02), (0.04, 0.09, 0.28), (0.03, 0.035, 0.04), (0.04, 0.09, 0.28))
    )


def _banded(up_m: Floats, limits_m: tuple[float, ...], colours: tuple[Rgb, ...]) -> Floats:
    return np.asarray(colours, np.float32)[np.searchsorted(limits_m, up_m)]


def _mixed(low: Rgb | Floats, high: Rgb, share: Array | Floats) -> Floats:
    """Return the mixture of two colours by share (N,); `low` is one colour, or one for each spot (N, 3)."""
    begin = np.asarray(low, np.float32)
    return begin + share.astype(np.float32)[:, None] * (single(high) - begin)


def _tinted(colour: Rgb | Floats, shade: Array | Floats) -> Floats:
    """Return a colour, or one for each spot (N, 3), darkened or lightened by shade (N,), kept above black."""
    return np.asarray(colour, np.float32) * np.maximum(shade, 0.12).astype(np.float32)[:, None]


# The ground cover: bare soil on the track, grass and tall grass beside it, gravel, rock on steep slopes. Layers lie on
# the terrain's lattice, (ny, nx, `LAYERS`) float32: the shares of soil, gravel, rock and tall grass, 0 to 1 (the rest
# is grass). Further layers are the height in metres and its gradients along x and y, from which the normal is computed.
# As outdoors, looks go with drivability: the track is bare, slopes beyond `STEEP_RAD` are scree, then rock, and ditches
# have banks of earth.


SOIL, GRAVEL, ROCK, TALL, HEIGHT, ALONG_X, ALONG_Y = range(7)
LAYERS = 7
TRACK_HALF_WIDTH_M = 1.3
WHEEL_ASIDE_M = 0.36
STEEP_RAD = (
    MAX_SLOPE_RAD,
    float(np.deg2rad(30.0)),
    float(np.deg2rad(37.0)),
)  # start of gravel, start of rock, all rock


@dataclass(frozen=True, eq=False)
class GroundCover:
    """Layers (ny, nx, `LAYERS`), the lattice's origin (2,) and resolution in metres."""

    layers: NDArray[np.float32]
    origin_m: tuple[float, float]
    resolution_m: float

    def at(self, xy: Floats) -> Floats:
        """Return every layer at positions (N, 2): (N, `LAYERS`), bilinear; the edge continues outside the lattice."""
        column_row = (xy - single(self.origin_m)) / np.float32(self.resolution_m)
        sampled: Floats = _bilinear(self.layers, column_row)
        return sampled


def build_ground_cover(terrain: Terrain, rng: np.random.Generator) -> GroundCover:
    """Return the cover of this terrain; patches are drawn at random, the rest follows from slope, lowland and track."""
    shape = (terrain.height_m.shape[0], terrain.height_m.shape[1])
    ragged, patches = fractal(shape, (0.8, 6.0), 1.2, rng), fractal(shape, (3.0, 18.0), 1.4, rng)
    slope = drivability(terrain.height_m, terrain.resolution_m).slope_rad + 0.05 * ragged
    steep = _rising(slope, STEEP_RAD[1], STEEP_RAD[2])
    rock = np.where(terrain.lowland, 0.25 * steep, steep)
    soil = np.maximum(_track(terrain, ragged, patches), np.where(terrain.lowland, steep, 0.0)) * (1 - rock)
    loose = np.maximum(_rising(slope, STEEP_RAD[0], STEEP_RAD[1]), 0.8 * _rising(-patches, 1.1, 1.6))
    gravel = loose * (1 - rock - soil)
    tall = _rising(patches, 0.3, 0.8) * _rising(terrain.path_distance_m, 2.0, 3.0)
    along_y, along_x = np.gradient(terrain.height_m, terrain.resolution_m)
    layers = (soil, gravel, rock, tall * (1 - rock - soil - gravel), terrain.height_m, along_x, along_y)
    return GroundCover(np.stack(layers, axis=-1).astype(np.float32), terrain.origin_m, terrain.resolution_m)


def smooth_normals(layers: Floats) -> Floats:
    """Return the ground's unit normals (N, 3), upwards, from the layers."""
    normals = np.stack([-layers[:, ALONG_X], -layers[:, ALONG_Y], np.ones(len(layers), np.float32)], axis=-1)
    return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))


def _track(terrain: Terrain, ragged: Array, patches: Array) -> Array:
    """Return the track's share (N,): bare in the wheel ruts, partly overgrown between and beside them."""
    distance = terrain.path_distance_m + 0.18 * ragged
    worn = 1 - _rising(distance, TRACK_HALF_WIDTH_M - 0.5, TRACK_HALF_WIDTH_M + 0.3)
    rut = 1 - _rising(np.abs(distance - WHEEL_ASIDE_M), 0.12, 0.3)
    overgrown = 0.75 * _rising(patches, -0.2, 0.6)
    return np.asarray(np.maximum(worn * (1 - overgrown), 0.9 * rut))


def _rising(values: Array, low: float, high: float) -> Array:
    """Return a smooth step from 0 up to `low` to 1 from `high`."""
    ratio = np.clip((values - low) / (high - low), 0.0, 1.0)
    return np.asarray(ratio * ratio * (3 - 2 * ratio))


@njit(cache=True, nogil=True, error_model="numpy")
def _bilinear(layers, column_row):  # type: ignore[no-untyped-def]
    rows, columns, depth = layers.shape
    sampled = np.empty((len(column_row), depth), np.float32)
    for index in range(len(column_row)):
        column = min(max(column_row[index, 0], np.float32(0)), np.float32(columns - 1))
        row = min(max(column_row[index, 1], np.float32(0)), np.float32(rows - 1))
        i, j = min(int(row), rows - 2), min(int(column), columns - 2)
        u, v = column - np.float32(j), row - np.float32(i)
        for layer in range(depth):
            low = layers[i, j, layer] * (1 - u) + layers[i, j + 1, layer] * u
            high = layers[i + 1, j, layer] * (1 - u) + layers[i + 1, j + 1, layer] * u
            sampled[index, layer] = low * (1 - v) + high * v
    return sampled
