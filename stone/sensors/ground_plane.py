"""Where the ground lies under the robot, by what the LiDAR sees around it: whether its mount was entered rightly.

**Conventions.** In the ego frame, whose origin should lie on the ground under the footprint, with x and y along it. A
plane is z = height_m + slope_x · x + slope_y · y. One sweep's plane is that of the terrain around it; over a run, hills
and hollows cancel, and what stays is the calibration's: one height and one tilt.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stone.geometry.se3 import SE3, shortest_turn_to_z

NEAREST_M, FARTHEST_M = 0.8, 12.0
LOWEST_M, HIGHEST_M = -2.5, 1.5
CELL_M, LOW_QUANTILE = 0.3, 0.3
FEWEST_IN_CELL, FEWEST_CELLS, FULL_SHARE = 3, 24, 0.2
REACHES_M = (2.5, 3.0, 4.0, 6.0, 8.0, FARTHEST_M)  # the nearest that is full enough, or shows enough: terrain bends
TRIPLES, INLIER_M, STEEPEST = 200, 0.08, 0.35  # tan 19°: steeper is no ground a mount could be held against
LEAST_INLIERS = 0.4
FITS, FAR_M = 12, 0.15
FEWEST_SWEEPS = 5
UPRIGHT = 0.3
TOLERATED_M, TOLERATED_RAD = 0.07, float(np.deg2rad(1.5))
SEED = 17

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
        """Whether it lies farther from the ego origin than terrain explains."""
        return abs(self.height_m) > TOLERATED_M

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


def plane_around(points_ego: NDArray[np.float32]) -> Array | None:
    """(height_m, slope_x, slope_y) of the ground around the robot by the points (N, 3) of one sweep; None where too
    little of it is seen, or no plane holds."""
    cells = _lowest(points_ego)
    around = [cells[np.hypot(cells[:, 0], cells[:, 1]) <= reach_m] for reach_m in REACHES_M]
    shown = [near for near in around if len(near) >= FEWEST_CELLS and _is_around(near)]
    full = [near for near, reach_m in zip(around, REACHES_M, strict=True) if _share(near, reach_m) >= FULL_SHARE]
    chosen = [near for near in full if _is_around(near)] or shown
    return _plane(chosen[0]) if chosen else None


def _share(cells: Array, reach_m: float) -> float:
    """How much of the plan within reach the cells are: of little, it may be what stands beside the robot."""
    return len(cells) * CELL_M**2 / (np.pi * reach_m**2)


def ground_fit(planes: list[Array]) -> GroundFit | None:
    """What the planes of a run agree on; None for fewer than `FEWEST_SWEEPS`."""
    if len(planes) < FEWEST_SWEEPS:
        return None
    all_planes = np.stack(planes)
    quarter = len(planes) // 4
    height_m, slope_x, slope_y = np.sort(all_planes, axis=0)[quarter : len(planes) - quarter].mean(axis=0).tolist()
    low_m, high_m = np.quantile(all_planes[:, 0], [0.05, 0.95]).tolist()
    return GroundFit(len(planes), height_m, slope_x, slope_y, low_m, high_m)


def around_robot(points_ego: NDArray[np.float32]) -> Array:
    """Those of the points (N, 3) that may be ground near the robot."""
    points = points_ego.astype(np.float64)
    far_m = np.hypot(points[:, 0], points[:, 1])
    is_near = (far_m >= NEAREST_M) & (far_m <= FARTHEST_M) & (points[:, 2] >= LOWEST_M) & (points[:, 2] <= HIGHEST_M)
    return np.asarray(points[is_near])


def low_points(points: Array, cell: NDArray[np.int64]) -> tuple[NDArray[np.int64], Array]:
    """The cells (C,) that hold `FEWEST_IN_CELL` of the points (N, 3), sorted, and the point (C, 3) of each that is at a
    low quantile of height; `cell` (N,) says which each point is in."""
    order = np.lexsort((points[:, 2], cell))
    points, cell = points[order], cell[order]
    first = np.flatnonzero(np.append(True, np.diff(cell) != 0)[: len(cell)])
    count = np.diff(np.append(first, len(cell)))
    is_full = count >= FEWEST_IN_CELL
    lowest = points[first + (LOW_QUANTILE * (count - 1)).astype(np.int64)]
    return cell[first][is_full], np.asarray(lowest[is_full])


def _lowest(points_ego: NDArray[np.float32]) -> Array:
    """The low points (C, 3) of cells around the robot."""
    points = around_robot(points_ego)
    index = np.floor(points[:, :2] / CELL_M).astype(np.int64) + 1000
    return low_points(points, index[:, 0] * 10_000 + index[:, 1])[1]


def _is_around(cells: Array) -> bool:
    """Whether they lie on at least three of the four sides of the robot: a plane on one side is no ground under it."""
    sides = np.floor((np.arctan2(cells[:, 1], cells[:, 0]) + np.pi) / (np.pi / 2)).astype(np.int64) % 4
    return len(np.unique(sides)) >= 3


def _plane(cells: Array) -> Array | None:
    """The plane that most cells lie on, by triples of them, then by robust least squares; None below a share."""
    rng = np.random.default_rng(SEED)
    triples = cells[rng.integers(0, len(cells), (TRIPLES, 3))]
    design = np.concatenate([np.ones((TRIPLES, 3, 1)), triples[:, :, :2]], axis=2)
    solvable = np.abs(np.linalg.det(design)) > CELL_M**2
    if not solvable.any():
        return None
    planes = np.linalg.solve(design[solvable], triples[solvable][:, :, 2:])[:, :, 0]
    planes = planes[np.hypot(planes[:, 1], planes[:, 2]) <= STEEPEST]
    if not len(planes):
        return None
    everywhere = np.column_stack([np.ones(len(cells)), cells[:, :2]])
    off_m = np.abs(cells[:, 2] - planes @ everywhere.T)
    plane = planes[np.argmax((off_m <= INLIER_M).sum(axis=1))]
    for _ in range(FITS):
        off_m = np.abs(cells[:, 2] - everywhere @ plane)
        if (off_m <= INLIER_M).sum() < max(LEAST_INLIERS * len(cells), 3):
            return None
        root = np.clip(1.0 - np.square(off_m / FAR_M), 0.0, None)  # of Tukey's biweight: no cell comes or goes at once
        plane = np.linalg.lstsq(everywhere * root[:, None], cells[:, 2] * root, rcond=None)[0]
    return np.asarray(plane)
