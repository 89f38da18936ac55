"""Objects on the terrain: rocks, bushes, trees, walls and grass, as triangles and as obstacles.

**Conventions.** `OBSTACLE` rows are upright cylinders in the world: the space inside is not drivable at any height up
to the top. A tree's crown may hang over drivable ground, so only its trunk is an obstacle and the crown is an overhang.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from simulator.scenery import shapes
from simulator.scenery.terrain import Terrain
from stone.geometry.se3 import Array

OBSTACLE = np.dtype([("x", "f8"), ("y", "f8"), ("radius", "f8"), ("bottom", "f8"), ("top", "f8"), ("surface", "u1")])
EDGE_M = 3.0
WALL_THICKNESS_M = 0.3
WALL_HEIGHT_M = 1.8


class Surface(IntEnum):
    """The surface that a ray hits."""

    SKY = 0
    GROUND = 1
    ROCK = 2
    BUSH = 3
    TRUNK = 4
    CROWN = 5
    WALL = 6
    GRASS = 7
    WALKER = 8
    ROBOT = 9
    VEHICLE = 10


@dataclass(frozen=True, eq=False)
class Objects:
    """Triangles (T, 3, 3) with their `Surface` (T,), obstacles and overhangs (rows of `OBSTACLE`)."""

    triangles: NDArray[np.float32]
    surface: NDArray[np.uint8]
    obstacles: NDArray[np.void]
    overhangs: NDArray[np.void]


@dataclass(frozen=True)
class Cover:
    """The density of one kind: one object per given m² of lowland and of hillside, from `clear_m` to `within_m` from
    the track; `scale` times the usual size.
    """

    lowland_m2: float
    hillside_m2: float
    clear_m: float
    within_m: float = np.inf
    scale: float = 1.0


COVERS = {
    Surface.ROCK: Cover(110.0, 30.0, 1.7),
    Surface.BUSH: Cover(110.0, 14.0, 1.8),
    Surface.TRUNK: Cover(420.0, 45.0, 2.2),
    Surface.WALL: Cover(1400.0, np.inf, 4.6),
    Surface.GRASS: Cover(260.0, np.inf, 0.0),
}
# Within a robot's width of its path; the largest rock reaches 0.5 m from its centre, the robot 0.43 m from its path.
BESIDE = {
    Surface.ROCK: Cover(8.0, 8.0, 1.0, 2.0, scale=0.4),
    Surface.BUSH: Cover(16.0, 16.0, 1.3, 2.4, scale=0.6),
    Surface.GRASS: Cover(4.0, 4.0, 0.0, 0.8),
}


@dataclass
class _Yard:
    """A collector of placed objects inside `place_objects`."""

    soups: list[Array]
    surfaces: list[NDArray[np.uint8]]
    obstacles: list[tuple[float, float, float, float, float, int]]
    overhangs: list[tuple[float, float, float, float, float, int]]

    def stand(self, soup: Array, foot: Array, surface: Surface) -> None:
        self.soups.append(soup + foot)
        self.surfaces.append(np.full(len(soup), surface, np.uint8))

    def block(self, foot: Array, radius_m: float, height_m: float, surface: Surface) -> None:
        x, y, z = foot
        self.obstacles.append((x, y, radius_m, z - 0.5, z + height_m, int(surface)))


def place_objects(terrain: Terrain, rng: np.random.Generator, beside: np.random.Generator | None = None) -> Objects:
    """Scatter every kind by its cover; the same generator state gives the same objects.

    With a generator `beside`, more objects are placed near the track; the others stay unchanged.
    """
    yard = _Yard([], [], [], [])
    _scatter(yard, COVERS, terrain, rng)
    if beside is not None:
        _scatter(yard, BESIDE, terrain, beside)
    if not yard.soups:
        yard.stand(np.zeros((1, 3, 3)), np.zeros(3), Surface.ROCK)
    return Objects(
        np.concatenate(yard.soups).astype(np.float32),
        np.concatenate(yard.surfaces),
        np.array(yard.obstacles, OBSTACLE),
        np.array(yard.overhangs, OBSTACLE),
    )


def _scatter(yard: _Yard, covers: Mapping[Surface, Cover], terrain: Terrain, rng: np.random.Generator) -> None:
    placers: dict[Surface, Callable[[_Yard, Array, Terrain, np.random.Generator, float], None]] = {
        Surface.ROCK: _rock,
        Surface.BUSH: _bush,
        Surface.TRUNK: _tree,
        Surface.WALL: _wall,
        Surface.GRASS: _grass,
    }
    for surface, cover in covers.items():
        for foot in _feet(terrain, cover, rng):
            placers[surface](yard, foot, terrain, rng, cover.scale)


def _feet(terrain: Terrain, cover: Cover, rng: np.random.Generator) -> Array:
    """Return points on the ground (N, 3): uniform darts, kept with the density at their position."""
    width, depth = terrain.extent_m
    densest = 1 / min(cover.lowland_m2, cover.hillside_m2)
    count = int(width * depth * densest)
    xy = rng.uniform((EDGE_M, EDGE_M), (width - EDGE_M, depth - EDGE_M), (count, 2))
    chance = rng.random(count)
    column, row = np.round(terrain.lattice(xy)).astype(np.int64).T
    wanted = np.where(terrain.lowland[row, column], 1 / cover.lowland_m2, 1 / cover.hillside_m2) / densest
    away_m = terrain.path_distance_m[row, column]
    kept = xy[(chance < wanted) & (away_m > cover.clear_m) & (away_m < cover.within_m)]
    return np.concatenate([kept, terrain.elevation_m(kept)[:, None]], axis=1)


def _raised(foot: Array, height_m: float) -> Array:
    return np.asarray(foot + np.array([0.0, 0.0, height_m]))


def _rock(yard: _Yard, foot: Array, terrain: Terrain, rng: np.random.Generator, scale: float) -> None:
    radius = scale * rng.uniform(0.3, 0.9)
    axes = radius * np.array([rng.uniform(0.8, 1.3), rng.uniform(0.8, 1.3), 0.8])
    yard.stand(shapes.boulder(axes, rng), _raised(foot, 0.15 * radius), Surface.ROCK)
    yard.block(foot, 1.1 * float(axes[:2].max()), 1.2 * radius, Surface.ROCK)


def _bush(yard: _Yard, foot: Array, terrain: Terrain, rng: np.random.Generator, scale: float) -> None:
    radius = scale * rng.uniform(0.5, 1.1)
    soup = shapes.leaves(radius * np.array([1.0, 1.0, 0.9]), int(420 * radius**2) + 60, 0.045, rng)
    yard.stand(soup, _raised(foot, 0.8 * radius), Surface.BUSH)
    yard.block(foot, radius, 1.9 * radius, Surface.BUSH)


def _tree(yard: _Yard, foot: Array, terrain: Terrain, rng: np.random.Generator, scale: float) -> None:
    height, radius, reach = (
        scale * rng.uniform(3.0, 6.0),
        scale * rng.uniform(0.12, 0.25),
        scale * rng.uniform(1.2, 2.2),
    )
    yard.stand(shapes.trunk(radius, height + 0.5), foot, Surface.TRUNK)
    yard.block(foot, radius + 0.1, height + 0.5, Surface.TRUNK)
    crown = shapes.leaves(reach * np.array([1.0, 1.0, 0.7]), int(300 * reach**2), 0.07, rng)
    yard.stand(crown, _raised(foot, height + 0.3 * reach), Surface.CROWN)
    x, y, z = foot
    low = z + height - 0.5 * reach
    yard.overhangs.append((x, y, reach + 0.3, low, low + 2 * reach, int(Surface.CROWN)))


def _wall(yard: _Yard, foot: Array, terrain: Terrain, rng: np.random.Generator, scale: float) -> None:
    """Add a straight wall unless its ends would come near the track."""
    length, yaw = scale * rng.uniform(5.0, 9.0), rng.uniform(0, np.pi)
    along = np.arange(-length / 2, length / 2 + 0.1, 0.2)
    line = foot[:2] + along[:, None] * (np.cos(yaw), np.sin(yaw))
    column, row = np.round(terrain.lattice(line)).astype(np.int64).T
    rows, columns = terrain.height_m.shape
    inside = (column >= 0) & (row >= 0) & (column < columns) & (row < rows)
    if not inside.all() or terrain.path_distance_m[row, column].min() < 2.0:
        return
    yard.stand(shapes.wall(length, WALL_THICKNESS_M, WALL_HEIGHT_M, yaw), foot, Surface.WALL)
    for x, y in line:
        yard.block(np.array([x, y, foot[2]]), 0.25, WALL_HEIGHT_M, Surface.WALL)


def _grass(yard: _Yard, foot: Array, terrain: Terrain, rng: np.random.Generator, scale: float) -> None:
    spread = scale * rng.uniform(0.6, 1.5)
    soup = shapes.blades(int(60 * spread**2), spread, rng)
    ground = terrain.elevation_m(soup[:, 0, :2] + foot[:2])
    soup[..., 2] += (ground - foot[2])[:, None]
    yard.stand(soup, foot, Surface.GRASS)
