"""What covers the ground: bare soil on the track, grass and tall grass beside it, gravel, rock where it is steep.

**Conventions.** Layers lie on the terrain's lattice, (ny, nx, `LAYERS`) float32: how much of the ground is soil,
gravel, rock and tall grass, 0 to 1 (what is left is grass); its height in metres, and its two gradients along x and y,
of which the normal is made. As outdoors, looks go with drivability: the track is bare, slopes beyond `STEEP_RAD` are
scree, then rock, and ditches have banks of earth.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simulator.appearance.noise import Floats, single
from simulator.scenery.drivability import MAX_SLOPE_RAD, drivability
from simulator.scenery.terrain import Terrain, fractal
from stone.geometry.se3 import Array

SOIL, GRAVEL, ROCK, TALL, HEIGHT, ALONG_X, ALONG_Y = range(7)
LAYERS = 7
TRACK_HALF_WIDTH_M = 1.3
WHEEL_ASIDE_M = 0.36
STEEP_RAD = (MAX_SLOPE_RAD, float(np.deg2rad(30.0)), float(np.deg2rad(37.0)))  # gravel begins, rock begins, all rock


@dataclass(frozen=True, eq=False)
class GroundCover:
    """Layers (ny, nx, `LAYERS`), the lattice's origin (2,) and resolution in metres."""

    layers: NDArray[np.float32]
    origin_m: tuple[float, float]
    resolution_m: float

    def at(self, xy: Floats) -> Floats:
        """Every layer at places (N, 2): (N, `LAYERS`), bilinear; beyond the lattice its edge goes on."""
        column_row = (xy - single(self.origin_m)) / np.float32(self.resolution_m)
        sampled: Floats = _bilinear(self.layers, column_row)
        return sampled


def build_ground_cover(terrain: Terrain, rng: np.random.Generator) -> GroundCover:
    """The cover of this terrain; patches are drawn, the rest follows from slope, lowland and track."""
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
    """The ground's unit normals (N, 3), up, where the layers are these."""
    normals = np.stack([-layers[:, ALONG_X], -layers[:, ALONG_Y], np.ones(len(layers), np.float32)], axis=-1)
    return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))


def _track(terrain: Terrain, ragged: Array, patches: Array) -> Array:
    """Bare where wheels have been, overgrown between and beside them in stretches."""
    distance = terrain.path_distance_m + 0.18 * ragged
    worn = 1 - _rising(distance, TRACK_HALF_WIDTH_M - 0.5, TRACK_HALF_WIDTH_M + 0.3)
    rut = 1 - _rising(np.abs(distance - WHEEL_ASIDE_M), 0.12, 0.3)
    overgrown = 0.75 * _rising(patches, -0.2, 0.6)
    return np.asarray(np.maximum(worn * (1 - overgrown), 0.9 * rut))


def _rising(values: Array, low: float, high: float) -> Array:
    """0 up to `low`, 1 from `high`, smooth between."""
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
