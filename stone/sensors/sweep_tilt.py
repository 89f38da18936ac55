"""The tilt of the sweeps in the map, by looks at the same ground from two places, so that terrain cancels.

    height of a link = slope_x · (x₂ − x₁) + slope_y · (y₂ − y₁)

**Conventions.** x₁, y₁ and x₂, y₂ are where the ego frames of the first and the second look have the ground that both
saw (`stone.sensors.ground_links`). Slopes are of the ground in the ego frame, less that of the way that the poses
drive: a LiDAR entered tilted and poses that are tilted look alike, and poses that climb against their own attitude do.
A straight way shows no slope across it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone.geometry.se3 import SE3
from stone.sensors.clocks import MAD_TO_SIGMA
from stone.sensors.ground_links import Links, Way, of_one_visit

ROUNDS, ROBUST_M, FEWEST_LINKS, RIDGE = 8, 0.02, 8, 1e-6

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SweepTilt:
    """Slopes along and across the ego frame, and their standard errors."""

    slope_x: float
    error_x: float
    slope_y: float
    error_y: float


def sweep_tilt(links: Links, way: Way, map_from_ego: SE3) -> SweepTilt | None:
    """Return the tilt by the links of one visit each, of looks from these poses (K,); None for fewer than
    `FEWEST_LINKS`."""
    is_near = of_one_visit(links, way)
    if is_near.sum() < FEWEST_LINKS:
        return None
    (first, second), middle_m = links.pairs[is_near].T, links.middle_m[is_near]
    axes = map_from_ego.as_matrix()[:, :2, :2]
    design = _seen_at(middle_m, way.places_m[second], axes[second]) - _seen_at(
        middle_m, way.places_m[first], axes[first]
    )
    height_m, weight = links.height_m[is_near], np.ones(len(design))
    for _ in range(ROUNDS):
        normal = design.T @ (weight[:, None] * design) + RIDGE * np.eye(2)
        slopes = np.linalg.solve(normal, design.T @ (weight * height_m))
        off_m = np.abs(height_m - design @ slopes)
        weight = ROBUST_M / np.maximum(off_m, ROBUST_M)
    # Links of a look share its errors: as many are independent as there are looks.
    spread = MAD_TO_SIGMA * float(np.median(off_m)) * np.sqrt(len(design) / len(np.unique(links.pairs)))
    errors = spread * np.sqrt(np.diag(np.linalg.inv(normal)))
    return SweepTilt(float(slopes[0]), float(errors[0]), float(slopes[1]), float(errors[1]))


def _seen_at(middle_m: Array, places_m: Array, axes: Array) -> Array:
    """Return where (L, 2) the ego frames at places (L, 2) with axes (L, 2, 2) in plan have the middles (L, 2)."""
    return np.asarray(np.einsum("nij,ni->nj", axes, middle_m - places_m))
