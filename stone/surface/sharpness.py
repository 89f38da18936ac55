"""Sharpness of a map: inconsistent poses smear a surface over more voxels and make it thick.

**Conventions.** Measured over windows of consecutive frames, each mapped separately, so that memory holds one window.
Two sets of poses are always compared on the same points of the same windows.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone.geometry.se3 import SE3
from stone.surface.neighbours import cells_of, plane_fits
from stone.surface.pointmap import PointMapBuilder

VOXEL_M = 0.1
CELL_M = 0.2
NEIGHBOURS = 20


@dataclass(frozen=True)
class Sharpness:
    """The number of filled `voxels`, summed over windows; `thickness_m`: median r.m.s. distance of points to their
    local plane.
    """

    voxels: int
    thickness_m: float


class SharpnessMeter:
    """Measures frame after frame; `measured` closes the last window."""

    def __init__(self, frames_per_window: int = 60) -> None:
        self._frames_per_window = frames_per_window
        self._builder = PointMapBuilder(VOXEL_M)
        self._frames = 0
        self._voxels: list[int] = []
        self._thickness_m: list[float] = []

    def add(self, points_ego: NDArray[np.float32], map_from_ego: SE3, sensor_ego: NDArray[np.float64]) -> None:
        """Add one frame's points (N, 3) at one pose."""
        self._builder.insert(points_ego, map_from_ego, sensor_ego)
        self._frames += 1
        if self._frames == self._frames_per_window:
            self._close()

    def measured(self) -> Sharpness:
        """Return the sharpness over all windows; thickness 0 without any plane."""
        if self._frames:
            self._close()
        thickness_m = float(np.average(self._thickness_m, weights=self._voxels)) if sum(self._voxels) else 0.0
        return Sharpness(sum(self._voxels), thickness_m)

    def _close(self) -> None:
        points = self._builder.finish()
        fits = plane_fits(cells_of(points.centroids_map(), CELL_M), NEIGHBOURS)
        known = fits.mean_square_m2[np.isfinite(fits.mean_square_m2)]
        self._voxels.append(len(points))
        self._thickness_m.append(float(np.sqrt(np.median(known))) if len(known) else 0.0)
        self._builder = PointMapBuilder(VOXEL_M)
        self._frames = 0
