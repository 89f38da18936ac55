"""Label grids that resemble off-road scenes, and predictions with a network's correlated errors.

**Conventions.** Grids are (256, 256, 32) uint8, z fastest. A window slides over a fractal world, so neighbouring frames
are similar. The same seed gives the same grids.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone.labels.grid import Grid
from stone_base.label_grid import PAPER

X, Y, Z = PAPER.shape
WORLD = 1024
LAYERS = np.arange(Z, dtype=np.float32)
STEP = 4

Field = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class GridWorld:
    """Per square: ground height in voxels, class 1–3, height of bushes in voxels."""

    height: Field
    classes: NDArray[np.uint8]
    bushes: Field


def fractal(random: np.random.Generator, size: int, roughness: float, coarsest: float) -> Field:
    """Return noise of unit deviation with spectrum f^−roughness, flat below wavelength `coarsest`."""
    frequency = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size)[None, :])
    spectrum = np.maximum(frequency, 1 / coarsest) ** -roughness
    noise = np.fft.irfft2(np.fft.rfft2(random.standard_normal((size, size))) * spectrum, (size, size))
    return np.asarray(noise / noise.std(), dtype=np.float32)


def world(random: np.random.Generator) -> GridWorld:
    height = 3 * fractal(random, WORLD, 2.4, 400)
    slope = np.hypot(*np.gradient(height))
    difficulty = fractal(random, WORLD, 1.8, 200) + 2 * (slope - 0.3)
    classes = 1 + (difficulty > 0.2).astype(np.uint8) + (difficulty > 1.5)
    bushes = np.clip(6 * (fractal(random, WORLD, 1.5, 40) - 1.6), 0, 14) * (classes > 1)
    return GridWorld(height, classes, bushes)


def render(random: np.random.Generator, seen: GridWorld, floor: float, porous_ratio: float) -> Grid:
    """Return the ground as a sheet of 1–3 voxels, with bushes above it as a porous mass."""
    above = LAYERS - (seen.height - floor)[..., None]
    is_bush = (above > 0) & (above < seen.bushes[..., None])
    is_bush &= random.random(PAPER.shape, dtype=np.float32) > porous_ratio
    solid = np.where(seen.bushes > 4, 3, 2).astype(np.uint8)[..., None]
    return np.where(np.abs(above) <= 0.9, seen.classes[..., None], np.where(is_bush, solid, 0)).astype(np.uint8)


def mistaken(random: np.random.Generator, truth: GridWorld) -> GridWorld:
    """Return a network's view: heights off by half a voxel, patches of another class, bushes missed and invented."""
    errors = [fractal(random, X, 1.5, 60) for _ in range(3)]
    classes = np.where(errors[1] > 1.1, truth.classes % 3 + 1, truth.classes).astype(np.uint8)
    bushes = np.clip(truth.bushes + 1.5 * errors[2] * (truth.bushes > 0), 0, None)
    return GridWorld(truth.height + 0.5 * errors[0], classes, np.where(errors[2] > 2.2, 3, bushes).astype(np.float32))


def frames(count: int, seed: int = 1) -> Iterator[tuple[Grid, Grid]]:
    """Yield (ground truth, prediction) of `count` frames along a straight drive."""
    random = np.random.default_rng(seed)
    whole = world(random)
    for index in range(count):
        rows, columns = (np.arange(n) + STEP * index for n in (X, Y))
        cut = np.ix_(rows % WORLD, columns % WORLD)
        seen = GridWorld(whole.height[cut], whole.classes[cut], whole.bushes[cut])
        floor = float(np.median(seen.height[112:144, 112:144])) - 10
        yield render(random, seen, floor, 0.35), render(random, mistaken(random, seen), floor, 0.05)


def seen_by_lidar(truth: Grid) -> Grid:
    """Return the voxels that a ray can reach: from the lowest surface of a column up, none in columns without a
    surface.
    """
    is_occupied = truth > 0
    height = truth.shape[2]
    lowest = np.where(is_occupied.any(axis=2), is_occupied.argmax(axis=2), height)
    return np.asarray(np.arange(height) >= lowest[..., None], dtype=np.uint8)
