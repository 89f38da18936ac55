"""The ground: rolling fractal lowland between steep hillsides, with a ditch.

**Conventions.** A terrain is a lattice of heights: `height_m[i, j]` at `origin + (j, i) · resolution`, bilinear
between. Lowland rolls along x, so that one drive covers the heights of the drivable ground around it. Hillsides rise at
33–43° from the lowland's edge and are undrivable because of their slope.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, gaussian_filter, map_coordinates

from stone.geometry.se3 import Array

RESOLUTION_M = 0.2
PATH_CLEAR_M = 3.2
HILL_COVER_RATIO = 0.50
DITCH_DEPTH_M = 1.1


@dataclass(frozen=True, eq=False)
class Terrain:
    """Heights (ny, nx) on a lattice, and the mask of the lowland."""

    height_m: Array
    lowland: NDArray[np.bool_]
    path_distance_m: Array
    origin_m: tuple[float, float] = (0.0, 0.0)
    resolution_m: float = RESOLUTION_M

    def elevation_m(self, xy: Array) -> Array:
        """Return the ground height at (..., 2) world points; outside the lattice, the nearest edge's height."""
        return bilinear(self.height_m, self.lattice(xy))

    def lattice(self, xy: Array) -> Array:
        """Return the fractional (column, row) of world points."""
        return np.asarray((xy - np.asarray(self.origin_m)) / self.resolution_m)

    @property
    def extent_m(self) -> tuple[float, float]:
        rows, columns = self.height_m.shape
        return (columns - 1) * self.resolution_m, (rows - 1) * self.resolution_m


def bilinear(field: Array, column_row: Array) -> Array:
    """Return a lattice field at fractional (..., 2) positions."""
    position = [column_row[..., 1], column_row[..., 0]]
    return np.asarray(map_coordinates(field, position, order=1, mode="nearest"))


def fractal(shape: tuple[int, int], band_m: tuple[float, float], beta: float, rng: np.random.Generator) -> Array:
    """Return noise of zero mean and unit deviation; its amplitude falls as frequency^−beta inside the band of
    wavelengths.
    """
    ky = np.fft.fftfreq(shape[0], RESOLUTION_M)[:, None]
    kx = np.fft.rfftfreq(shape[1], RESOLUTION_M)[None]
    k = np.hypot(ky, kx)
    inside = (k > 1 / band_m[1]) & (k < 1 / band_m[0])
    amplitude = np.where(inside, np.maximum(k, 1e-9) ** -beta, 0.0)
    noise = np.fft.irfft2(amplitude * np.exp(2j * np.pi * rng.random(k.shape)), s=shape)
    return np.asarray((noise - noise.mean()) / noise.std())


def build_terrain(extent_m: tuple[float, float], track_m: Array, rng: np.random.Generator) -> Terrain:
    """Return the ground for a drive along `track_m` (K, 2) inside `extent_m`."""
    shape = (round(extent_m[1] / RESOLUTION_M) + 1, round(extent_m[0] / RESOLUTION_M) + 1)
    distance = _distance_to(track_m, shape)
    lowland = _lowland(distance, rng)
    height = (
        _rollers(shape, float(track_m[0, 0]), rng)
        + _hillsides(lowland, rng)
        + _micro_relief(lowland, rng)
        - _ditch(track_m, shape, rng)
    )
    return Terrain(height, lowland, distance)


def _distance_to(track_m: Array, shape: tuple[int, int]) -> Array:
    off_track = np.ones(shape, bool)
    column, row = np.round(track_m / RESOLUTION_M).astype(np.int64).T
    off_track[row, column] = False
    return np.asarray(distance_transform_edt(off_track) * RESOLUTION_M)


def _lowland(distance_m: Array, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Return the mask of the valley floor: below the quantile of a fractal, and always beside the track."""
    hilliness = fractal((distance_m.shape[0], distance_m.shape[1]), (14.0, 40.0), 1.5, rng)
    hilliness -= 2.0 * np.exp(-((distance_m / 4.0) ** 2))
    return (hilliness < np.quantile(hilliness, 1 - HILL_COVER_RATIO)) | (distance_m < PATH_CLEAR_M)


def _rollers(shape: tuple[int, int], start_x_m: float, rng: np.random.Generator) -> Array:
    """Return swells across the valley with bent crests: heights repeat along x, slopes stay below ≈ 18°.

    The drive starts near a crest or a hollow, so that even 20 s of it contain both.
    """
    x = np.arange(shape[1]) * RESOLUTION_M
    start = np.pi / 2 * rng.choice([-1.0, 1.0]) + rng.uniform(-0.4, 0.4)
    phase = rng.uniform(0, 2 * np.pi)
    along = x[None] - start_x_m + 0.8 * fractal(shape, (25.0, 80.0), 1.5, rng)
    swell = 1.45 * np.sin(2 * np.pi * along / 42.0 + start) + 0.18 * np.sin(2 * np.pi * along / 13.0 + phase)
    return np.asarray(swell + 0.06 * fractal(shape, (8.0, 20.0), 1.5, rng))


def _hillsides(lowland: NDArray[np.bool_], rng: np.random.Generator) -> Array:
    """Return the height above the lowland: distance to its edge times the tangent of 33–43°, with broken rock on it."""
    shape = (lowland.shape[0], lowland.shape[1])
    distance = distance_transform_edt(~lowland) * RESOLUTION_M
    steepness = np.tan(np.deg2rad(38.0 + 2.5 * np.clip(fractal(shape, (10.0, 40.0), 1.5, rng), -2, 2)))
    broken = 0.10 * fractal(shape, (0.8, 4.0), 1.5, rng) * np.clip(distance / 1.5, 0, 1)
    return np.asarray(gaussian_filter(distance * steepness, 0.25 / RESOLUTION_M) + broken)


def _micro_relief(lowland: NDArray[np.bool_], rng: np.random.Generator) -> Array:
    """Return tufts and stones of centimetres, in patches, equally beside the track and away from it."""
    shape = (lowland.shape[0], lowland.shape[1])
    patches = np.clip(0.6 + 0.5 * fractal(shape, (4.0, 20.0), 1.5, rng), 0.1, 1.6)
    return 0.025 * fractal(shape, (1.0, 6.0), 1.5, rng) + 0.012 * patches * rng.standard_normal(shape)


def _ditch(track_m: Array, shape: tuple[int, int], rng: np.random.Generator) -> Array:
    """Return a V-shaped ditch (48°) that follows the track 6–9 m to one side, in stretches."""
    x, y = np.arange(shape[1]) * RESOLUTION_M, np.arange(shape[0]) * RESOLUTION_M
    side = rng.choice([-1.0, 1.0])
    aside = np.interp(x, track_m[:, 0], track_m[:, 1]) + side * (7.5 + 1.2 * np.sin(x / 9.0))
    depth = DITCH_DEPTH_M * np.clip(2.5 * np.sin(x / 11.0 + rng.uniform(0, 2 * np.pi)) + 1.0, 0, 1)
    return np.asarray(np.maximum(0.0, depth[None] - 1.1 * np.abs(y[:, None] - aside[None])))
