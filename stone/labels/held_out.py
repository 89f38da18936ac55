"""Held-out quality: labels are made from one part of the track and judged on ground driven in the other part.

**Conventions.** Judged voxels are driven in the judged part and never in the known part. The robot drove there, so T or
P is right and N is wrong. Distances in plan are to the nearest voxel of the known part.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone.labels.voxels import VOXEL_M

BANDS_M = (0.0, 5.0, 10.0, 20.0, np.inf)
OTHER_MAP_M = 1e7  # distance between two maps: effectively infinite


@dataclass(frozen=True, eq=False)
class HeldOut:
    """The numbers of judged `voxels` (4,) and of those `kept` (4,) as T or P, by distance from the known track
    (`BANDS_M`).

    The judged voxels correspond to `judged_m` metres of track that cross no known ground; the known voxels to `known_m`
    metres.
    """

    voxels: NDArray[np.int64]
    kept: NDArray[np.int64]
    judged_m: float
    known_m: float

    @property
    def recall(self) -> float:
        """The share of all judged voxels that are T or P."""
        return float(self.kept.sum() / self.voxels.sum())


@dataclass(frozen=True, eq=False)
class DrivenPlaces:
    """The centres of n driven voxels in plan (n, 2), in metres, and the map (n,) of each."""

    centres_m: NDArray[np.float64]
    maps: NDArray[np.int64]

    def where(self, keep: NDArray[np.bool_]) -> "DrivenPlaces":
        return DrivenPlaces(self.centres_m[keep], self.maps[keep])

    def apart(self) -> NDArray[np.float64]:
        """Return the centres (n, 3) with different maps far from each other."""
        return np.column_stack([self.centres_m, self.maps * OTHER_MAP_M])


def held_out(known: DrivenPlaces, judged: DrivenPlaces, is_kept: NDArray[np.bool_], width_m: float) -> HeldOut:
    """Count the judged voxels (n > 0) that are kept as T or P, (n,), by their distance from the known ones (m > 0)."""
    from scipy.spatial import cKDTree

    away_m, _ = cKDTree(known.apart()).query(judged.apart())
    voxels, _ = np.histogram(away_m, BANDS_M)
    kept, _ = np.histogram(away_m[is_kept], BANDS_M)
    across_m = VOXEL_M**2 / width_m
    return HeldOut(voxels, kept, len(is_kept) * across_m, len(known.maps) * across_m)
