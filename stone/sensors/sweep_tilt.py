"""The tilt of the sweeps in the map, from looks at the same ground from two positions, so that terrain cancels.

    height of a link = slope_x · (x₂ − x₁) + slope_y · (y₂ − y₁)

**Conventions.** x₁, y₁ and x₂, y₂ are the positions of the common ground in the ego frames of the first and the second
look (`stone.sensors.ground_links`). Slopes are the ground's slopes in the ego frame minus the way's. A tilted LiDAR
mount, tilted poses, and poses that climb against their own attitude look alike. A straight way reveals no slope across
it.
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
    """Return the tilt from the links of consecutive looks at these poses (K,); None for fewer than `FEWEST_LINKS`."""
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
    # Links of a look share its errors, so the number of independent links is the number of looks.
    spread = MAD_TO_SIGMA * float(np.median(off_m)) * np.sqrt(len(design) / len(np.unique(links.pairs)))
    errors = spread * np.sqrt(np.diag(np.linalg.inv(normal)))
    return SweepTilt(float(slopes[0]), float(errors[0]), float(slopes[1]), float(errors[1]))


def _seen_at(middle_m: Array, places_m: Array, axes: Array) -> Array:
    """Return the positions (L, 2) of the centres (L, 2) in ego frames at positions (L, 2) with axes (L, 2, 2) in
    plan.
    """
    return np.asarray(np.einsum("nij,ni->nj", axes, middle_m - places_m))
