"""A simulated pedestrian who walks ahead of the robot and crosses its path.

**Conventions.** An upright cylinder; its foot is a function of time alone, in world coordinates.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from simulator.scenery.path import DriveTrajectory
from stone.geometry.se3 import Array

RADIUS_M = 0.25
HEIGHT_M = 1.75
AHEAD_NS = 5_000_000_000
SWAY_M = 2.5
SWAY_PERIOD_NS = 8_000_000_000


class WalkableGround(Protocol):
    """What is walked on: the terrain of a simulation, or the truth about it."""

    def elevation_m(self, xy: Array) -> Array: ...


@dataclass(frozen=True, eq=False)
class Walker:
    """Walks where the robot will be in five seconds, swaying across its track."""

    trajectory: DriveTrajectory
    terrain: WalkableGround

    def foot_m(self, stamp_ns: int) -> Array:
        """Centre of the soles (3,) on the ground."""
        start = self.trajectory.start_ns
        pose = self.trajectory.at(np.array([stamp_ns + AHEAD_NS]))
        sway = SWAY_M * np.sin(2 * np.pi * (stamp_ns - start) / SWAY_PERIOD_NS)
        xy = (pose @ np.array([[0.0, sway, 0.0]]))[:, :2]
        return np.append(xy[0], self.terrain.elevation_m(xy))


def walker_range(foot_m: Array, origins: NDArray[np.float32], directions: NDArray[np.float32]) -> NDArray[np.float32]:
    """Distance along unit rays (N, 3) to the walker's side, inf where they miss."""
    offset = foot_m[:2].astype(np.float32) - origins[:, :2]
    plan = directions[:, :2]
    a = np.maximum(np.einsum("ij,ij->i", plan, plan), 1e-12)
    b = np.einsum("ij,ij->i", plan, offset)
    disc = b * b - a * (np.einsum("ij,ij->i", offset, offset) - RADIUS_M**2)
    reach = (b - np.sqrt(np.maximum(disc, 0))) / a
    z = origins[:, 2] + reach * directions[:, 2] - np.float32(foot_m[2])
    is_hit = (disc > 0) & (reach > 0) & (z > 0) & (z < HEIGHT_M)
    return np.where(is_hit, reach, np.inf).astype(np.float32)
