"""How well labels hold where the robot drove later: made from one part of its way, judged by the other part.

**Conventions.** Judged are voxels that the robot drove over in the judged part and never in the known one. It drove
there, so T or P is right and N is wrong. Distances in plan are those to the nearest voxel of the known part.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone.labels.voxels import VOXEL_M

BANDS_M = (0.0, 5.0, 10.0, 20.0, np.inf)
OTHER_MAP_M = 1e7  # two maps lie nowhere to each other


@dataclass(frozen=True, eq=False)
class HeldOut:
    """`voxels` (4,) that were judged, by distance from the known way (`BANDS_M`), and how many were `kept` (4,) as T or
    P. They are as many as a way of `judged_m` metres leaves that crosses no known ground; the known ones are as many as
    `known_m` metres leave."""

    voxels: NDArray[np.int64]
    kept: NDArray[np.int64]
    judged_m: float
    known_m: float

    @property
    def recall(self) -> float:
        """The share of all judged voxels that is T or P."""
        return float(self.kept.sum() / self.voxels.sum())


@dataclass(frozen=True, eq=False)
class DrivenPlaces:
    """Of n driven voxels: their centres in plan (n, 2), metres, and the map (n,) that each is in."""

    centres_m: NDArray[np.float64]
    maps: NDArray[np.int64]

    def where(self, keep: NDArray[np.bool_]) -> "DrivenPlaces":
        return DrivenPlaces(self.centres_m[keep], self.maps[keep])

    def apart(self) -> NDArray[np.float64]:
        """(n, 3) with maps far from each other."""
        return np.column_stack([self.centres_m, self.maps * OTHER_MAP_M])


def held_out(known: DrivenPlaces, judged: DrivenPlaces, is_kept: NDArray[np.bool_], width_m: float) -> HeldOut:
    """Count the judged voxels (n > 0) that are kept as T or P, (n,), by their distance from the known ones (m > 0)."""
    from scipy.spatial import cKDTree

    away_m, _ = cKDTree(known.apart()).query(judged.apart())
    voxels, _ = np.histogram(away_m, BANDS_M)
    kept, _ = np.histogram(away_m[is_kept], BANDS_M)
    across_m = VOXEL_M**2 / width_m
    return HeldOut(voxels, kept, len(is_kept) * across_m, len(known.maps) * across_m)
