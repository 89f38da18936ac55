"""One simulated world and one drive through it, drawn from the seed.

**Conventions.** World = map = ENU at `ORIGIN_DEG_M`. The clock starts at a fixed instant, so that equal options give
equal bytes. Each part has its own generator: more columns must not move a tree.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, maximum_filter, minimum_filter

from simulator.options import SimulateOptions
from simulator.scenery.movers import AHEAD_S, Mover, movers_of
from simulator.scenery.objects import Objects, place_objects
from simulator.scenery.path import POSE_NS, SPEED_SWING_RATIO, DriveTrajectory, drive, driven_m, plan_track
from simulator.scenery.terrain import Terrain, build_terrain
from stone.geometry.se3 import Array

START_NS = 1_749_718_800_000_000_000  # 2025-06-12 09:00 UTC
ORIGIN_DEG_M = (48.05, 11.55, 560.0)
MARGIN_M = 42.0


@dataclass(frozen=True, eq=False)
class SimulatedWorld:
    """The ground, the objects, the robot's exact motion and the movers."""

    terrain: Terrain
    objects: Objects
    trajectory: DriveTrajectory
    movers: tuple[Mover, ...]


def generator(seed: int, part: str) -> np.random.Generator:
    """Return an independent generator for one named part of the simulation."""
    return np.random.default_rng([seed, *part.encode()])


def build_world(options: SimulateOptions) -> SimulatedWorld:
    """Return the world; the valley is as long as the drive, and poses continue beyond its end by the walker's lead."""
    driven_s = options.seconds + AHEAD_S + 1.0
    length_m = driven_s * options.speed_m_s * (1 + SPEED_SWING_RATIO) + 2.0
    start = (MARGIN_M, options.world_width_m / 2)
    track = plan_track(length_m, start, generator(options.seed, "track"))
    extent = (float(track.points_m[-1, 0]) + MARGIN_M, options.world_width_m)
    terrain = build_terrain(extent, track.points_m, generator(options.seed, "terrain"))
    beside = generator(options.seed, "beside") if options.beside_track else None
    objects = place_objects(terrain, generator(options.seed, "objects"), beside)
    driven = driven_m(options.speed_m_s, round(driven_s * 1e9) // POSE_NS + 1)
    trajectory = drive(track, terrain, START_NS, driven)
    return SimulatedWorld(terrain, objects, trajectory, movers_of(options, trajectory, terrain))


# The drivable ground of a tracked robot of 1.06 × 0.85 m, from the exact heights alone. It is measured at the scale of
# the robot: the ground smoothed over 0.4 m gives the slope; the residual gives roughness and steps. Fields have the
# lattice's shape (ny, nx).


PLANE_SCALE_M = 0.4
MAX_SLOPE_RAD = float(np.deg2rad(22.0))
MAX_RESIDUAL_M = 0.05
MAX_STEP_M = 0.3
STEP_WINDOW_M = 1.0


@dataclass(frozen=True, eq=False)
class Drivability:
    """Slope in radians and the verdict, per lattice point."""

    slope_rad: Array
    is_drivable: NDArray[np.bool_]


def drivability(height_m: Array, resolution_m: float) -> Drivability:
    """Return the ground that is gentle, smooth and without steps at the robot's scale."""
    sigma = PLANE_SCALE_M / resolution_m
    smooth = gaussian_filter(height_m, sigma, mode="nearest")
    along_y, along_x = np.gradient(smooth, resolution_m)
    slope = np.arctan(np.hypot(along_x, along_y))
    removed = height_m - smooth
    residual = np.sqrt(gaussian_filter(removed**2, sigma, mode="nearest"))
    window = round(STEP_WINDOW_M / resolution_m)
    step = maximum_filter(removed, window) - minimum_filter(removed, window)
    return Drivability(slope, (slope < MAX_SLOPE_RAD) & (residual < MAX_RESIDUAL_M) & (step < MAX_STEP_M))
