"""Where a tracked robot of 1.06 × 0.85 m can drive, from the exact heights alone.

**Conventions.** Measured at the scale of the robot: the ground smoothed over 0.4 m gives the slope; what the
smoothing removed gives roughness and steps. Fields have the lattice's shape (ny, nx).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, maximum_filter, minimum_filter

from stone.geometry.se3 import Array

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
    """Gentle, smooth and without steps at the robot's scale."""
    sigma = PLANE_SCALE_M / resolution_m
    smooth = gaussian_filter(height_m, sigma, mode="nearest")
    along_y, along_x = np.gradient(smooth, resolution_m)
    slope = np.arctan(np.hypot(along_x, along_y))
    removed = height_m - smooth
    residual = np.sqrt(gaussian_filter(removed**2, sigma, mode="nearest"))
    window = round(STEP_WINDOW_M / resolution_m)
    step = maximum_filter(removed, window) - minimum_filter(removed, window)
    return Drivability(slope, (slope < MAX_SLOPE_RAD) & (residual < MAX_RESIDUAL_M) & (step < MAX_STEP_M))
