"""Profiles: which features of a voxel are held against the driven ground, how, and what the vehicle forbids besides.

**Conventions.** `paper` is the paper to the letter: absolute elevation, slope and roughness of the vertices in the
voxel (Eq. 4–6). `local` takes the height above the ground nearby for the elevation. `field` takes slope and roughness
averaged over the voxel's neighbours too (most voxels hold a single vertex), counts only what is higher, steeper or
rougher than the driven ground against a voxel, and calls N what the vehicle cannot get over or under.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.geometry.lattice import Keys
from stone.labels.ground_shape import GroundShape
from stone.labels.traversability import Reference, distance_squared
from stone.labels.voxels import VoxelFeatures
from stone.sensors.calibration import Vehicle

Profile = Literal["paper", "local", "field"]
Array = NDArray[np.float64]


@dataclass(frozen=True)
class ProfileRule:
    """How a profile judges a voxel."""

    is_local: bool = False
    is_pooled: bool = False
    is_one_sided: bool = False
    is_limited: bool = False


RULES: Mapping[Profile, ProfileRule] = {
    "paper": ProfileRule(),
    "local": ProfileRule(is_local=True),
    "field": ProfileRule(is_local=True, is_pooled=True, is_one_sided=True, is_limited=True),
}
FEATURES, HEIGHT, POOLED, SLOPE, STEP, CLEARANCE, LOOKS = slice(0, 3), 3, slice(4, 7), 7, 8, 9, 10


@dataclass(frozen=True, eq=False)
class VoxelTerrain:
    """All that any profile asks of the voxels `keys` (K,), in `columns` (K, 11).

    The columns are the features of Eq. 4–5; height above the local ground, m; the pooled features; the slope under a
    footprint, rad; the step, m; the clearance, m; the frames that hit the voxel.
    """

    keys: Keys
    columns: Array

    def __len__(self) -> int:
        return len(self.keys)

    def where(self, keep: NDArray[np.bool_]) -> "VoxelTerrain":
        return VoxelTerrain(self.keys[keep], np.compress(keep, self.columns, axis=0))

    def features(self, rule: ProfileRule) -> Array:
        """(K, 3) as the profile takes them: elevation m, slope rad, roughness log m²."""
        found: Array = self.columns[:, POOLED if rule.is_pooled else FEATURES].copy()
        found[:, 0] = self.columns[:, HEIGHT if rule.is_local else 0]
        return found

    @property
    def slope_deg(self) -> Array:
        """(K,) of the ground under a footprint."""
        return np.rad2deg(self.columns[:, SLOPE])

    def limit_ratios(self, vehicle: Vehicle) -> Array:
        """(K, 3) the shares of the vehicle's limits that a voxel takes: slope, step and height."""
        slope = self.slope_deg / vehicle.max_slope_deg
        step = self.columns[:, STEP] / vehicle.max_step_m
        return np.column_stack([slope, step, vehicle.height_m / self.columns[:, CLEARANCE]])

    def limit_ratio(self, vehicle: Vehicle) -> Array:
        """(K,) the largest of the shares; above 1 the vehicle cannot pass."""
        found: Array = self.limit_ratios(vehicle).max(axis=1)
        return found


def terrain_of(voxels: VoxelFeatures, height_m: Array, shape: GroundShape, looks: NDArray[np.int64]) -> VoxelTerrain:
    """What was measured of the voxels, in one table."""
    rest = (shape.pooled, shape.slope_rad, shape.step_m, shape.clearance_m, looks)
    return VoxelTerrain(voxels.keys, np.column_stack([voxels.features, height_m, *rest]))


def distances(terrain: VoxelTerrain, reference: Reference, rule: ProfileRule, limits: tuple[Vehicle, float]) -> Array:
    """Return the D² (K,) that decides the class of each voxel against the threshold in `limits`, beside the vehicle.

    In a profile that knows the vehicle it is no less than the threshold times the squared share of its limits, so
    that D² exceeds the threshold exactly if the reference or the vehicle rules the voxel out.
    """
    vehicle, limit = limits
    features = terrain.features(rule)
    squared = exceedance_squared(features, reference) if rule.is_one_sided else distance_squared(features, reference)
    if not rule.is_limited:
        return squared
    return np.maximum(squared, limit * np.square(terrain.limit_ratio(vehicle)))


def exceedance_squared(features: Array, reference: Reference) -> Array:
    """Return the least D² (K,) of all ground that is at least as high, steep and rough as the features (K, 3).

    It never falls if a feature rises, and is 0 for what lies below the mean in all. The least D² over a cone is the
    greatest marginal D² of the subsets of features whose multipliers are not negative (its dual; Perlman, 1969).
    """
    inverses = np.zeros((7, 3, 3))
    for number in range(7):
        rows = np.flatnonzero([(number + 1) >> axis & 1 for axis in range(3)])
        inverses[number][np.ix_(rows, rows)] = np.linalg.inv(reference.covariance[np.ix_(rows, rows)])
    found = np.zeros(len(features))
    _exceed(features - reference.mean, inverses, found)
    return found


@njit(cache=True, nogil=True)
def _exceed(centred, inverses, found):  # type: ignore[no-untyped-def]
    for row in range(centred.shape[0]):
        x, y, z = centred[row]
        for number in range(inverses.shape[0]):
            m = inverses[number]
            a = m[0, 0] * x + m[0, 1] * y + m[0, 2] * z
            b = m[1, 0] * x + m[1, 1] * y + m[1, 2] * z
            c = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z
            if a >= 0 and b >= 0 and c >= 0:
                found[row] = max(found[row], a * x + b * y + c * z)
