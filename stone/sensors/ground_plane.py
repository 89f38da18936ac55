"""Where the ground lies under the robot, by what the LiDAR sees around it: whether its mount was entered rightly.

**Conventions.** In the ego frame, whose origin should lie on the ground under the footprint, with x and y along it. A
plane is z = height_m + slope_x · x + slope_y · y. One sweep's plane is that of the terrain around it; over a run, hills
and hollows cancel, and what stays is the calibration's: one height and one tilt.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stone.geometry.se3 import SE3, shortest_turn_to_z

FEWEST_SWEEPS = 5
UPRIGHT = 0.3
TOLERATED_M, TOLERATED_RAD = 0.07, float(np.deg2rad(1.5))
TERRAIN_SHARE = 0.25  # of what its sweeps differ by: 16 channels saw hills 0 to 0.6 m above a mount that was right

Array = NDArray[np.float64]


@dataclass(frozen=True)
class GroundFit:
    """Over the `sweeps` in which ground was found: its height (m) and slopes, each the mean of the middle half, and
    the 5th and 95th centile of the height."""

    sweeps: int
    height_m: float
    slope_x: float
    slope_y: float
    low_m: float
    high_m: float

    @property
    def tilt_rad(self) -> float:
        return float(np.arctan(np.hypot(self.slope_x, self.slope_y)))

    @property
    def is_high_or_low(self) -> bool:
        """Whether it lies farther from the ego origin than terrain explains, the more the more its sweeps differ."""
        return abs(self.height_m) > TOLERATED_M + TERRAIN_SHARE * (self.high_m - self.low_m)

    @property
    def is_off_in_all(self) -> bool:
        """Whether nine sweeps of ten show it on the same side, farther than terrain explains: no hill does that."""
        return self.low_m > TOLERATED_M or self.high_m < -TOLERATED_M

    @property
    def is_tilted(self) -> bool:
        """Whether it leans more than terrain explains."""
        return self.tilt_rad > TOLERATED_RAD

    def untilted(self) -> "GroundFit":
        """Its height alone."""
        return replace(self, slope_x=0.0, slope_y=0.0)

    def beyond_terrain(self) -> "GroundFit":
        """What the mount is to blame for: the height and the tilt, each only where terrain does not explain it."""
        level = self if self.is_tilted else self.untilted()
        return level if self.is_high_or_low else replace(level, height_m=0.0)

    def corrected(self, ego_from_lidar: SE3) -> SE3:
        """The mount with which the ground lies where it should: as high above it as it is seen to be and turned until
        it is level, its place and the heading of its x axis in plan as they were entered."""
        normal = np.array([-self.slope_x, -self.slope_y, 1.0])
        normal /= np.linalg.norm(normal)
        turned = SE3.from_parts(shortest_turn_to_z(normal), np.zeros(3)) @ ego_from_lidar
        yaw_rad = _heading_rad(ego_from_lidar) - _heading_rad(turned)
        back = np.array([np.cos(yaw_rad / 2), 0.0, 0.0, np.sin(yaw_rad / 2)])
        place_m = ego_from_lidar.translation_m
        above_m = float(normal @ (place_m - np.array([0.0, 0.0, self.height_m])))
        wxyz = (SE3.from_parts(back, np.zeros(3)) @ turned).wxyz
        return SE3.from_parts(wxyz, np.array([place_m[0], place_m[1], above_m]))


def _heading_rad(ego_from_lidar: SE3) -> float:
    """Where the LiDAR's x axis points in plan; 0 where it points up or down."""
    x, y, _ = ego_from_lidar.rotation()[:, 0]
    return float(np.arctan2(y, x)) if np.hypot(x, y) > UPRIGHT else 0.0


def ground_fit(planes: list[Array]) -> GroundFit | None:
    """What the planes of a run agree on; None for fewer than `FEWEST_SWEEPS`."""
    if len(planes) < FEWEST_SWEEPS:
        return None
    all_planes = np.stack(planes)
    quarter = len(planes) // 4
    height_m, slope_x, slope_y = np.sort(all_planes, axis=0)[quarter : len(planes) - quarter].mean(axis=0).tolist()
    low_m, high_m = np.quantile(all_planes[:, 0], [0.05, 0.95]).tolist()
    return GroundFit(len(planes), height_m, slope_x, slope_y, low_m, high_m)
