"""A flat, lit place with one wall: small enough that shade and edges follow from a drawing on paper."""

from collections.abc import Callable

import numpy as np

from simulator.appearance.renderer import Renderer, View
from simulator.options import SimulateOptions
from simulator.scenery import shapes
from simulator.scenery.movers import Mover
from simulator.scenery.objects import OBSTACLE, Objects, Surface
from simulator.scenery.path import DriveTrajectory
from simulator.scenery.scene import RayScene
from simulator.scenery.terrain import Terrain
from simulator.scenery.world import START_NS, SimulatedWorld
from stone.geometry.se3 import SE3

CENTRE_M = np.array([20.0, 20.0, 0.0])
WALL_AHEAD_M, WALL_TOP_M = 6.0, 1.8
OPTIONS = SimulateOptions(seconds=0.2, noise_ratio=0.0, traffic="none", camera_detail="full")


def stage(wall_ahead_m: float = WALL_AHEAD_M, movers: Callable[[DriveTrajectory], tuple[Mover, ...]] = lambda _: ()):
    """40 m × 40 m of lowland, the robot at rest in its middle, a wall along y ahead of it."""
    lattice = np.zeros((201, 201))
    terrain = Terrain(lattice, np.ones(lattice.shape, bool), np.full(lattice.shape, 10.0))
    wall = shapes.wall(8.0, 0.3, WALL_TOP_M, np.pi / 2) + CENTRE_M + (wall_ahead_m, 0, 0)
    none = np.zeros(0, OBSTACLE)
    objects = Objects(wall.astype(np.float32), np.full(len(wall), Surface.WALL, np.uint8), none, none)
    at_rest = SE3.from_parts(np.tile([1.0, 0, 0, 0], (401, 1)), np.tile(CENTRE_M, (401, 1)))
    trajectory = DriveTrajectory(START_NS, at_rest)
    return SimulatedWorld(terrain, objects, trajectory, movers(trajectory))


def renderer(world: SimulatedWorld, illumination: str = "day") -> Renderer:
    return Renderer(RayScene(world), SimulateOptions(seconds=0.2, illumination=illumination))


def looking_at(points: np.ndarray, origins: np.ndarray) -> View:
    """A ray from each origin (N, 3) to each point (N, 3), 3 mrad apart."""
    ways = points - origins
    directions = (ways / np.linalg.norm(ways, axis=1, keepdims=True)).astype(np.float32)
    return View(origins.astype(np.float32), directions, 0.003, START_NS, np.zeros((0, 7)))
