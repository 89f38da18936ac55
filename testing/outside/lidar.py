"""The LiDAR of an analytic drive, and the ideal ranges of every sweep.

**Conventions.** The LiDAR frame is the ego frame's axes at `EGO_FROM_LIDAR`. A sweep starts straight behind the robot
and turns clockwise in 0.1 s; all channels of a column are measured at once. Ranges are (sweeps, channels, columns),
float32, inf without a return.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from testing.outside.casting import FAR_M, Ceiling, cast
from testing.outside.ground import Array
from testing.outside.worlds import World

SWEEP_S, LIDAR_HEIGHT_M = 0.1, 1.1
FIELDS_DEG = {16: (-15.0, 15.0)}  # lowest and highest channel
USUAL_FIELD_DEG = (-25.0, 15.0)
EGO_FROM_LIDAR = np.array([[1.0, 0, 0, 0.1], [0, 1, 0, 0], [0, 0, 1, LIDAR_HEIGHT_M], [0, 0, 0, 1]])


@dataclass(frozen=True)
class Lidar:
    """A LiDAR with `channels` × `columns` rays in a sweep."""

    channels: int
    columns: int = 900

    def directions(self) -> Array:
        """Return the unit vectors (channels, columns, 3) in the LiDAR frame."""
        low, high = np.deg2rad(FIELDS_DEG.get(self.channels, USUAL_FIELD_DEG))
        up = np.linspace(low, high, self.channels)[:, None]
        turned = np.pi - 2 * np.pi * np.arange(self.columns) / self.columns
        return np.stack(np.broadcast_arrays(np.cos(up) * np.cos(turned), np.cos(up) * np.sin(turned), np.sin(up)), -1)

    def column_seconds(self) -> Array:
        """Return the measuring time of each column (columns,) after the sweep's stamp, in seconds."""
        return np.arange(self.columns) / self.columns * SWEEP_S


def ideal_ranges(world: World, lidar: Lidar, seed: int) -> NDArray[np.float32]:
    """Return the ranges that a perfect LiDAR measures on the whole drive."""
    sweeps, rng = round(world.track.seconds / SWEEP_S), np.random.default_rng(seed)
    ranges = np.empty((sweeps, lidar.channels, lidar.columns), np.float32)
    way = world.track.poses(np.linspace(0, world.track.seconds, 200))[:, :2, 3]
    ceiling = Ceiling(world.ground, way.min(axis=0) - FAR_M, way.max(axis=0) + FAR_M)
    directions = lidar.directions()
    for sweep in range(sweeps):
        begin = sweep * SWEEP_S
        poses = world.track.poses(begin + lidar.column_seconds()) @ EGO_FROM_LIDAR
        turned = np.einsum("aij,caj->cai", poses[:, :3, :3], directions).reshape(-1, 3)
        origins = np.broadcast_to(poses[None, :, :3, 3], directions.shape).reshape(-1, 3)
        solids, luck = world.all_solids(begin + SWEEP_S / 2), rng.random(len(turned))
        measured, _ = cast((np.ascontiguousarray(origins), turned), world.ground, ceiling, solids, luck)
        ranges[sweep] = measured.reshape(lidar.channels, lidar.columns)
    return ranges
