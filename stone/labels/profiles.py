"""Profiles: the voxel features that are compared with the driven ground, the comparison, and the vehicle's limits.

**Conventions.** `paper` is the paper's method: absolute elevation, slope and roughness of the vertices in the voxel
(Eq. 4–6). `local` replaces the elevation by the height above the ground nearby. `field` also averages slope and
roughness over the voxel's neighbours, because most voxels contain a single vertex. It penalises only features that are
higher, steeper or rougher than the driven ground. Obstacles that the vehicle cannot drive over or under are N.
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
    """The rules of a profile."""

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
    """The properties of the voxels `keys` (K,) that profiles use, in `columns` (K, 11).

    The first columns are the features of Eq. 4–5, the height above the local ground (m), and the pooled features. Then
    follow the slope under a footprint (rad), the step (m), the clearance (m), and the number of frames that hit the
    voxel.
    """

    keys: Keys
    columns: Array

    def __len__(self) -> int:
        return len(self.keys)

    def where(self, keep: NDArray[np.bool_]) -> "VoxelTerrain":
        return VoxelTerrain(self.keys[keep], np.compress(keep, self.columns, axis=0))

    def features(self, rule: ProfileRule) -> Array:
        """Return the profile's features (K, 3): elevation m, slope rad, roughness log m²."""
        features: Array = self.columns[:, POOLED if rule.is_pooled else FEATURES].copy()
        features[:, 0] = self.columns[:, HEIGHT if rule.is_local else 0]
        return features

    @property
    def slope_deg(self) -> Array:
        """The slope (K,) of the ground under a footprint."""
        return np.rad2deg(self.columns[:, SLOPE])

    def limit_ratios(self, vehicle: Vehicle) -> Array:
        """Return the shares (K, 3) of the vehicle's limits that a voxel uses: slope, step and height."""
        slope = self.slope_deg / vehicle.max_slope_deg
        step = self.columns[:, STEP] / vehicle.max_step_m
        return np.column_stack([slope, step, vehicle.height_m / self.columns[:, CLEARANCE]])

    def limit_ratio(self, vehicle: Vehicle) -> Array:
        """Return the largest share (K,); above 1 the vehicle cannot pass."""
        largest: Array = self.limit_ratios(vehicle).max(axis=1)
        return largest


def terrain_of(voxels: VoxelFeatures, height_m: Array, shape: GroundShape, looks: NDArray[np.int64]) -> VoxelTerrain:
    """Return the measured properties of the voxels in one table."""
    rest = (shape.pooled, shape.slope_rad, shape.step_m, shape.clearance_m, looks)
    return VoxelTerrain(voxels.keys, np.column_stack([voxels.features, height_m, *rest]))


def distances(terrain: VoxelTerrain, reference: Reference, rule: ProfileRule, limits: tuple[Vehicle, float]) -> Array:
    """Return the D² (K,) that decides each voxel's class, given the threshold in `limits` and the vehicle.

    In a profile that uses the vehicle, D² is at least the threshold times the squared share of its limits. D² then
    exceeds the threshold exactly if the reference or the vehicle excludes the voxel.
    """
    vehicle, limit = limits
    features = terrain.features(rule)
    squared = exceedance_squared(features, reference) if rule.is_one_sided else distance_squared(features, reference)
    if not rule.is_limited:
        return squared
    return np.maximum(squared, limit * np.square(terrain.limit_ratio(vehicle)))


def exceedance_squared(features: Array, reference: Reference) -> Array:
    """Return the least D² (K,) of all ground that is at least as high, steep and rough as the features (K, 3).

    It never decreases if a feature increases, and is 0 for features below all means. The least D² over a cone is the
    greatest marginal D² of the feature subsets whose multipliers are not negative (its dual; Perlman, 1969).
    """
    inverses = np.zeros((7, 3, 3))
    for number in range(7):
        rows = np.flatnonzero([(number + 1) >> axis & 1 for axis in range(3)])
        inverses[number][np.ix_(rows, rows)] = np.linalg.inv(reference.covariance[np.ix_(rows, rows)])
    squared = np.zeros(len(features))
    _exceed(features - reference.mean, inverses, squared)
    return squared


@njit(cache=True, nogil=True)
def _exceed(centred, inverses, squared):  # type: ignore[no-untyped-def]
    for row in range(centred.shape[0]):
        x, y, z = centred[row]
        for number in range(inverses.shape[0]):
            m = inverses[number]
            a = m[0, 0] * x + m[0, 1] * y + m[0, 2] * z
            b = m[1, 0] * x + m[1, 1] * y + m[1, 2] * z
            c = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z
            if a >= 0 and b >= 0 and c >= 0:
                squared[row] = max(squared[row], a * x + b * y + c * z)
