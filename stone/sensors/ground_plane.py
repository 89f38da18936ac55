"""The ground under the robot, from the LiDAR's view around it: a check of the LiDAR's mount.

**Conventions.** In the ego frame, whose origin should be on the ground under the footprint, with x and y along it. A
plane is z = height_m + slope_x · x + slope_y · y. One sweep's plane follows the terrain around it; over a run, hills
and hollows cancel, and the rest is the calibration's error: one height and one tilt. Terrain changes that tilt by up to
1.3°. Two looks at the same ground from different positions give the sweeps' tilt in the map to 0.2°
(`stone/sensors/sweep_tilt.py`). The poses give the robot's climb relative to its x axis. These distinguish three
faults, here with 2° each:

    ground in the ego frame | way in it | sweeps in the map | cause
    2°                      | 0°        | 2°                | the LiDAR's mount differs from the calibration: refused
    0°                      | −2°       | 2°                | the poses are tilted: refused
    2°                      | 2°        | 0°                | the body drives pitched: the map is right
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stone.errors import Refused
from stone.geometry.se3 import SE3, shortest_turn_to_z
from stone.sensors.calibration import entry_of

FEWEST_SWEEPS = 5
UPRIGHT = 0.3
BAND_M = 0.15  # around the footprint, the search band for driven ground
TOLERATED_M, TOLERATED_RAD = 0.07, float(np.deg2rad(1.5))
# A LiDAR pitched by 0.5° loses 2 to 3 % of drivable ground, by 1° 6 to 24 %; rolled by 1°, 2 to 5 %. Poses that drift
# in z by 1 % look like tilted ones, and are corrected.
MOST_PITCH, MOST_ROLL, MOST_WAY_SLOPE = np.tan(np.deg2rad([0.55, 1.0, 0.7])).tolist()
TERRAIN_SHARE = 0.25  # share of the sweeps' spread: 16 channels saw hills 0 to 0.6 m above a correct mount

Array = NDArray[np.float64]


@dataclass(frozen=True)
class GroundFit:
    """Over the `sweeps` with ground: its height (m) and slopes, each the mean of the middle half, and the 5th and 95th
    percentile of the height.

    `map_slope_x` and `map_slope_y` are the parts of the slopes by which the sweeps are tilted in the map; None if
    unknown.
    """

    sweeps: int
    height_m: float
    slope_x: float
    slope_y: float
    low_m: float
    high_m: float
    map_slope_x: float | None = None
    map_slope_y: float | None = None

    @property
    def way_slope(self) -> float:
        """The slope in the ego frame of the way that the poses drive; 0 if unknown."""
        return 0.0 if self.map_slope_x is None else self.slope_x - self.map_slope_x

    @property
    def tilt_rad(self) -> float:
        return float(np.arctan(np.hypot(self.slope_x, self.slope_y)))

    @property
    def is_high_or_low(self) -> bool:
        """Whether the ground is farther from the ego origin than terrain explains; the limit grows with the sweeps'
        spread.
        """
        return abs(self.height_m) > TOLERATED_M + TERRAIN_SHARE * (self.high_m - self.low_m)

    @property
    def is_off_in_all(self) -> bool:
        """Whether nine of ten sweeps show the ground on the same side, farther than terrain explains; no hill does
        that.
        """
        return self.low_m > TOLERATED_M or self.high_m < -TOLERATED_M

    @property
    def is_tilted(self) -> bool:
        """Whether the tilt exceeds what terrain explains."""
        return self.tilt_rad > TOLERATED_RAD or self.is_mount_tilted

    @property
    def is_map_tilted(self) -> bool:
        """Whether the sweeps have most of the ego frame's tilt in the map, or their tilt is unknown.

        Then the LiDAR alone is rotated on the robot; otherwise the poses have the same tilt.
        """
        if abs(self.slope_x) >= abs(self.slope_y):
            return self.map_slope_x is None or _is_most(self.map_slope_x, self.slope_x)
        return self.map_slope_y is None or _is_most(self.map_slope_y, self.slope_y)

    @property
    def is_mount_tilted(self) -> bool:
        """Whether the LiDAR's mount is certainly rotated so far that labels fail."""
        along, across = self.map_slope_x or 0.0, self.map_slope_y or 0.0
        is_across = min(abs(across), abs(self.slope_y)) > MOST_ROLL and across * self.slope_y > 0
        return is_across or (abs(along) > MOST_PITCH and not self._is_of_poses)

    @property
    def is_way_tilted(self) -> bool:
        """Whether the poses are certainly tilted so far that labels fail: the way climbs in the ego frame, the ground
        does not.
        """
        return abs(self.map_slope_x or 0.0) > MOST_WAY_SLOPE and self._is_of_poses

    @property
    def is_body_pitched(self) -> bool:
        """Whether the way and the ground are equally pitched in the ego frame, so the map is right."""
        return self.map_slope_x is not None and not _is_most(self.map_slope_x, -self.way_slope)

    @property
    def _is_of_poses(self) -> bool:
        return abs(self.way_slope) > abs(self.slope_x)

    def seen_from(self, ego_from_lidar: SE3) -> "GroundFit":
        """Return a fit in the LiDAR's frame converted to the ego frame by this mount; its tilt in the map is
        unknown.
        """
        normal = ego_from_lidar.rotation() @ np.array([-self.slope_x, -self.slope_y, 1.0])
        place_m = ego_from_lidar @ np.array([0.0, 0.0, self.height_m])
        height_m = float(normal @ place_m / normal[2])
        low_m, high_m = (height_m + edge_m - self.height_m for edge_m in (self.low_m, self.high_m))
        slope_x, slope_y = (-normal[:2] / normal[2]).tolist()
        return GroundFit(self.sweeps, height_m, slope_x, slope_y, low_m, high_m)

    def untilted(self) -> "GroundFit":
        """Return only its height."""
        return replace(self, slope_x=0.0, slope_y=0.0, map_slope_x=None, map_slope_y=None)

    def beyond_terrain(self) -> "GroundFit":
        """Return the mount's error: height and tilt, each only if terrain does not explain it."""
        level = self if self.is_tilted else self.untilted()
        return level if self.is_high_or_low else replace(level, height_m=0.0)

    def corrected(self, ego_from_lidar: SE3) -> SE3:
        """Return the mount that puts the ground at height 0 and level.

        The LiDAR's position in plan and the heading of its x axis stay as entered.
        """
        normal = np.array([-self.slope_x, -self.slope_y, 1.0])
        normal /= np.linalg.norm(normal)
        turned = SE3.from_parts(shortest_turn_to_z(normal), np.zeros(3)) @ ego_from_lidar
        yaw_rad = _heading_rad(ego_from_lidar) - _heading_rad(turned)
        back = np.array([np.cos(yaw_rad / 2), 0.0, 0.0, np.sin(yaw_rad / 2)])
        place_m = ego_from_lidar.translation_m
        above_m = float(normal @ (place_m - np.array([0.0, 0.0, self.height_m])))
        wxyz = (SE3.from_parts(back, np.zeros(3)) @ turned).wxyz
        return SE3.from_parts(wxyz, np.array([place_m[0], place_m[1], above_m]))


def surely_off_ground(ground: GroundFit, ego_from_lidar: SE3, band_m: float) -> Refused | None:
    """Return the refusal if a few sweeps show the ground at twice the band's distance; later sweeps cannot change
    that.
    """
    return footprint_off_ground(ground, ego_from_lidar, band_m) if is_off_ground(ground, 2 * band_m) else None


def is_off_ground(ground: GroundFit, band_m: float = BAND_M) -> bool:
    """Return whether nine of ten sweeps show the footprint farther from the ground than the band, on the same side."""
    return abs(ground.height_m) > band_m and ground.is_off_in_all


def footprint_off_ground(ground: GroundFit, ego_from_lidar: SE3, band_m: float) -> Refused:
    """Return the refusal with the ground's distance and the correction."""
    right = ground.beyond_terrain().corrected(ego_from_lidar)
    return Refused(
        "footprint_off_ground",
        f"the ground lies {above(ground)} and tilts by {np.rad2deg(ground.tilt_rad):.1f}°, outside the "
        f"footprint's search band of ±{band_m:g} m. Check the LiDAR's mount and the ego frame's height: "
        f"{entry_of(right)} would correct it; ground auto corrects it for this run",
    )


def above(ground: GroundFit) -> str:
    """Return the distance above or below the ego origin in words."""
    return f"{abs(ground.height_m):.2f} m {'above' if ground.height_m > 0 else 'below'} the ego origin"


def _is_most(part: float, slope: float) -> bool:
    return 2 * part * slope >= slope**2


def _heading_rad(ego_from_lidar: SE3) -> float:
    """Return the heading of the LiDAR's x axis in plan; 0 if it points up or down."""
    x, y, _ = ego_from_lidar.rotation()[:, 0]
    return float(np.arctan2(y, x)) if np.hypot(x, y) > UPRIGHT else 0.0


def ground_fit(planes: list[Array]) -> GroundFit | None:
    """Return the common plane of a run's planes; None for fewer than `FEWEST_SWEEPS`."""
    if len(planes) < FEWEST_SWEEPS:
        return None
    all_planes = np.stack(planes)
    quarter = len(planes) // 4
    height_m, slope_x, slope_y = np.sort(all_planes, axis=0)[quarter : len(planes) - quarter].mean(axis=0).tolist()
    low_m, high_m = np.quantile(all_planes[:, 0], [0.05, 0.95]).tolist()
    return GroundFit(len(planes), height_m, slope_x, slope_y, low_m, high_m)
