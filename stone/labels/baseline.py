"""A prediction from one sweep by geometry alone, without training: the row every method on a board should beat.

**Conventions.** Points are in the ego frame: origin on the ground under the robot, x forward, z up (REP 103). Grids are
those of `stone_base.label_grid`; a column is the square of a voxel seen from above. The ground of a column is its
lowest point, unless its neighbourhood lies much lower; gaps are closed from known neighbours, a ring of columns a pass.

    class of a column: N where slope or unevenness exceed what the robot climbs, else P; T where it is P and in the
    corridor that a robot driving straight on sweeps (the ground truth calls T what was driven, and one sweep knows no
    more of the path).

Source: elevation-map traversability, Wermelinger et al. (IROS 2016), reduced to slope and unevenness.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.errors import ShapeError
from stone.labels.grid import Grid
from stone_base.label_grid import PAPER, LabelGrid

FREE, T, P, N = 0, 1, 2, 3

Heights = NDArray[np.float32]


@dataclass(frozen=True)
class BaselineParameters:
    """Lengths in metres; columns are closed up to `gap_m` around each measured one."""

    steepest_rad: float = math.radians(25.0)
    most_uneven_m: float = 0.12
    most_rise_m: float = 0.5
    clearance_m: float = 0.3
    gap_m: float = 1.2
    corridor_reach_m: float = 15.0
    footprint_length_m: float = 1.06
    footprint_width_m: float = 0.85


DEFAULTS = BaselineParameters()


def predict_from_sweep(
    points_ego: NDArray[np.float32], parameters: BaselineParameters = DEFAULTS, label_grid: LabelGrid = PAPER
) -> Grid:
    """Classes of the label grid, uint8, from points (N, 3) of one sweep, metres.

    Points off the grid or not finite are passed over. Raises `ShapeError` for another shape.
    """
    if points_ego.ndim != 2 or points_ego.shape[1] != 3:
        raise ShapeError("points_ego", points_ego.shape, "(N, 3)")
    grid = np.zeros(label_grid.shape, np.uint8)
    lowest = np.full(label_grid.shape[:2], np.inf, np.float32)
    _measure(np.ascontiguousarray(points_ego, np.float32), lowest, _place(label_grid), grid)
    ground = ground_heights(lowest, parameters, label_grid)
    classes = column_classes(ground, parameters, label_grid)
    _paint(grid, ground, classes, (label_grid.min_m[2], label_grid.voxel_m, parameters.clearance_m))
    return grid


def _place(label_grid: LabelGrid) -> tuple[float, float, float, float]:
    """The lowest corner and the side of a voxel."""
    return (*label_grid.min_m, label_grid.voxel_m)


def ground_heights(
    lowest: Heights, parameters: BaselineParameters = DEFAULTS, label_grid: LabelGrid = PAPER
) -> Heights:
    """Ground (X, Y) in metres from the lowest point of each column (inf: none); NaN where unknown.

    The robot stands on z = 0, so its own footprint is known even where no ray reaches.
    """
    ground = np.full(lowest.shape, np.nan, np.float32)
    _keep_ground(lowest, parameters.most_rise_m, ground)
    x_m, y_m = column_centres_m(label_grid)
    is_under = (np.abs(x_m) <= parameters.footprint_length_m / 2) & (np.abs(y_m) <= parameters.footprint_width_m / 2)
    if np.isfinite(ground).any():
        ground[is_under & np.isnan(ground)] = 0.0
    for _ in range(round(parameters.gap_m / label_grid.voxel_m)):
        ground = _close_gaps(ground)
    return ground


def column_classes(
    ground: Heights, parameters: BaselineParameters = DEFAULTS, label_grid: LabelGrid = PAPER
) -> NDArray[np.uint8]:
    """T, P or N (X, Y) of the ground; 0 where it is unknown."""
    classes = np.zeros(ground.shape, np.uint8)
    most_rise_m = math.tan(parameters.steepest_rad) * label_grid.voxel_m
    _judge(ground, most_rise_m, parameters.most_uneven_m, classes)
    x_m, y_m = column_centres_m(label_grid)
    is_ahead = (np.abs(y_m) <= parameters.footprint_width_m / 2) & (np.abs(x_m) <= parameters.corridor_reach_m)
    classes[is_ahead & (classes == P)] = T
    return classes


def column_centres_m(label_grid: LabelGrid = PAPER) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """x (X, 1) and y (1, Y) of the columns' centres."""
    sides = ((label_grid.min_m[axis], label_grid.shape[axis]) for axis in (0, 1))
    x_m, y_m = (low_m + (np.arange(size) + 0.5) * label_grid.voxel_m for low_m, size in sides)
    return x_m[:, None].astype(np.float64), y_m[None, :].astype(np.float64)


@njit(cache=True, nogil=True)
def _measure(points: Heights, lowest: Heights, place: Any, grid: Grid) -> None:
    """Mark each voxel that holds a point as N, and keep the lowest z of each column."""
    (min_x_m, min_y_m, min_z_m, voxel_m), (sides_x, sides_y, sides_z) = place, grid.shape
    for p in range(points.shape[0]):
        x, y, z = points[p, 0], points[p, 1], points[p, 2]
        i = (x - min_x_m) / voxel_m
        j = (y - min_y_m) / voxel_m
        k = (z - min_z_m) / voxel_m
        if 0 <= i < sides_x and 0 <= j < sides_y and 0 <= k < sides_z:  # NaN fails
            grid[int(i), int(j), int(k)] = N
            lowest[int(i), int(j)] = min(lowest[int(i), int(j)], z)


@njit(cache=True, nogil=True)
def _keep_ground(lowest: Heights, most_rise_m: float, ground: Heights) -> None:
    """A lowest point is ground unless a point within two columns lies more than `most_rise_m` below it."""
    for i in range(ground.shape[0]):
        for j in range(ground.shape[1]):
            around = np.float32(np.inf)
            for a in range(max(i - 2, 0), min(i + 3, ground.shape[0])):
                for b in range(max(j - 2, 0), min(j + 3, ground.shape[1])):
                    around = min(around, lowest[a, b])
            if lowest[i, j] < np.inf and lowest[i, j] - around <= most_rise_m:
                ground[i, j] = lowest[i, j]


@njit(cache=True, nogil=True)
def _close_gaps(ground: Heights) -> Heights:
    """Unknown columns with at least two known neighbours of eight take their mean."""
    closed = ground.copy()
    for i in range(ground.shape[0]):
        for j in range(ground.shape[1]):
            if not np.isnan(ground[i, j]):
                continue
            total, known = 0.0, 0
            for a in range(max(i - 1, 0), min(i + 2, ground.shape[0])):
                for b in range(max(j - 1, 0), min(j + 2, ground.shape[1])):
                    if not np.isnan(ground[a, b]):
                        total += ground[a, b]
                        known += 1
            if known >= 2:
                closed[i, j] = total / known
    return closed


@njit(inline="always")
def _rise(before: Any, here: Any, after: Any) -> Any:
    """Height gained per column, from whichever neighbours are known."""
    if np.isnan(before):
        return 0.0 if np.isnan(after) else after - here
    return here - before if np.isnan(after) else (after - before) / 2


@njit(cache=True, nogil=True)
def _judge(ground: Heights, most_rise_m: float, most_uneven_m: float, classes: NDArray[np.uint8]) -> None:
    unknown, last_x, last_y = np.float32(np.nan), ground.shape[0] - 1, ground.shape[1] - 1
    for i in range(ground.shape[0]):
        for j in range(ground.shape[1]):
            here = ground[i, j]
            if np.isnan(here):
                continue
            dx = _rise(ground[i - 1, j] if i > 0 else unknown, here, ground[i + 1, j] if i < last_x else unknown)
            dy = _rise(ground[i, j - 1] if j > 0 else unknown, here, ground[i, j + 1] if j < last_y else unknown)
            uneven = 0.0
            for a in range(max(i - 1, 0), min(i + 2, ground.shape[0])):
                for b in range(max(j - 1, 0), min(j + 2, ground.shape[1])):
                    if not np.isnan(ground[a, b]):
                        uneven = max(uneven, abs(ground[a, b] - here - dx * (a - i) - dy * (b - j)))
            is_steep = math.sqrt(dx * dx + dy * dy) > most_rise_m
            classes[i, j] = N if is_steep or uneven > most_uneven_m else P


@njit(cache=True, nogil=True)
def _paint(grid: Grid, ground: Heights, classes: NDArray[np.uint8], heights: Any) -> None:
    """The ground voxel, and measured voxels within the clearance of it, take the column's class; the others stay N."""
    min_z_m, voxel_m, clearance_m = heights
    for i in range(ground.shape[0]):
        for j in range(ground.shape[1]):
            if classes[i, j] == FREE:
                continue
            floor = (ground[i, j] - min_z_m) / voxel_m
            if 0 <= floor < grid.shape[2]:
                grid[i, j, int(floor)] = classes[i, j]
            for k in range(grid.shape[2]):
                if grid[i, j, k] == N and abs((k + 0.5) * voxel_m + min_z_m - ground[i, j]) <= clearance_m:
                    grid[i, j, k] = classes[i, j]
