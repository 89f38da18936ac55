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
FEWEST_IN_CELL, FEWEST_CELLS = 3, 24
REACHES_M = (2.5, 3.0, 4.0, 6.0, 8.0, FARTHEST_M)  # the nearest that shows enough: terrain bends
TRIPLES, INLIER_M, STEEPEST = 200, 0.08, 0.35  # tan 19°: steeper is no ground a mount could be held against
LEAST_INLIERS = 0.4
FEWEST_SWEEPS = 5
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

    def beyond_terrain(self) -> "GroundFit":
        """What the mount is to blame for: the height and the tilt, each only where terrain does not explain it."""
        level = self if self.is_tilted else replace(self, slope_x=0.0, slope_y=0.0)
        return level if self.is_high_or_low else replace(level, height_m=0.0)

    def corrected(self, ego_from_lidar: SE3) -> SE3:
        """The mount with which the ground lies where it should: turned as little as can be, as high above the ground as
        it is seen to be, and in plan where it was entered, for how it is turned says nothing of where it sits."""
        normal = np.array([-self.slope_x, -self.slope_y, 1.0])
        normal /= np.linalg.norm(normal)
        turn = SE3.from_parts(shortest_turn_to_z(normal), np.zeros(3))
        place_m = ego_from_lidar.translation_m
        above_m = float(normal @ (place_m - np.array([0.0, 0.0, self.height_m])))
        return SE3.from_parts((turn @ ego_from_lidar).wxyz, np.array([place_m[0], place_m[1], above_m]))


def plane_around(points_ego: NDArray[np.float32]) -> Array | None:
    """(height_m, slope_x, slope_y) of the ground around the robot by the points (N, 3) of one sweep; None where too
    little of it is seen, or no plane holds."""
    cells = _lowest(points_ego)
    for reach_m in REACHES_M:
        near = cells[np.hypot(cells[:, 0], cells[:, 1]) <= reach_m]
        if len(near) >= FEWEST_CELLS and _is_around(near):
            return _plane(near)
    return None


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
    """The plane that most cells lie on, by triples of them, then by least squares over those; None below a share."""
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
    for _ in range(3):
        is_on = np.abs(cells[:, 2] - everywhere @ plane) <= INLIER_M
        if is_on.sum() < max(LEAST_INLIERS * len(cells), 3):
            return None
        plane = np.linalg.lstsq(everywhere[is_on], cells[is_on, 2], rcond=None)[0]
    return np.asarray(plane)
