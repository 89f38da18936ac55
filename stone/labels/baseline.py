"""A geometric prediction from one sweep, without training: the baseline that every method on a board should beat.

**Conventions.** Points are in the ego frame: origin on the ground under the robot, x forward, z up (REP 103). Grids are
those of `stone_base.label_grid`; a column is the square of a voxel seen from above. A column's ground is its lowest
point, unless its neighbourhood is much lower. Gaps are closed from known neighbours, one ring of columns per pass.

    class of a column: N if slope or unevenness exceed what the robot climbs, otherwise P; T if it is P and in the
        corridor of a robot that drives straight ahead (the ground truth labels driven ground T, and one sweep has no
        more of the path). If the earlier track is known, T behind the robot is the footprint's width along the track.

The module needs only NumPy, so that participants can run it without the platform.

Source: elevation-map traversability, Wermelinger et al. (IROS 2016), reduced to slope and unevenness.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone.errors import ShapeError
from stone_base.label_grid import PAPER, LabelGrid

FREE, T, P, N = 0, 1, 2, 3

Grid = NDArray[np.uint8]
Heights = NDArray[np.float32]
Track = NDArray[np.float64]
TRACK_STEP_M = 0.1


@dataclass(frozen=True)
class BaselineParameters:
    """Lengths in metres; columns are closed up to `gap_m` around each measured column."""

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
    points_ego: NDArray[np.float32],
    parameters: BaselineParameters = DEFAULTS,
    label_grid: LabelGrid = PAPER,
    track_ego_m: Track | None = None,
) -> Grid:
    """Return the classes of the label grid, uint8, from points (N, 3) of one or several sweeps, in metres.

    `track_ego_m` (M, 2) are earlier robot positions, oldest first, in metres. Points outside the grid or not finite are
    ignored. Raises `ShapeError` for another shape.
    """
    if points_ego.ndim != 2 or points_ego.shape[1] != 3:
        raise ShapeError("points_ego", points_ego.shape, "(N, 3)")
    grid = np.zeros(label_grid.shape, np.uint8)
    lowest = _measure(np.asarray(points_ego, np.float32), label_grid, grid)
    ground = ground_heights(lowest, parameters, label_grid)
    classes = column_classes(ground, parameters, label_grid, track_ego_m)
    _paint(grid, ground, classes, (label_grid, parameters.clearance_m))
    return grid


def ground_heights(
    lowest: Heights, parameters: BaselineParameters = DEFAULTS, label_grid: LabelGrid = PAPER
) -> Heights:
    """Return the ground (X, Y) in metres from the lowest point of each column (inf: none); NaN for unknown.

    The robot stands on z = 0, so the ground under its footprint is known even without rays.
    """
    ground = _kept_ground(lowest, parameters.most_rise_m)
    x_m, y_m = column_centres_m(label_grid)
    is_under = (np.abs(x_m) <= parameters.footprint_length_m / 2) & (np.abs(y_m) <= parameters.footprint_width_m / 2)
    if np.isfinite(ground).any():
        ground[is_under & np.isnan(ground)] = 0.0
    for _ in range(round(parameters.gap_m / label_grid.voxel_m)):
        ground = _close_gaps(ground)
    return ground


def column_classes(
    ground: Heights,
    parameters: BaselineParameters = DEFAULTS,
    label_grid: LabelGrid = PAPER,
    track_ego_m: Track | None = None,
) -> NDArray[np.uint8]:
    """Return T, P or N (X, Y) of the ground; 0 for unknown ground."""
    is_n = _is_blocking(ground, math.tan(parameters.steepest_rad) * label_grid.voxel_m, parameters.most_uneven_m)
    classes = np.where(np.isnan(ground), FREE, np.where(is_n, N, P)).astype(np.uint8)
    x_m, y_m = column_centres_m(label_grid)
    is_driven = (np.abs(y_m) <= parameters.footprint_width_m / 2) & (np.abs(x_m) <= parameters.corridor_reach_m)
    if track_ego_m is not None:
        is_driven &= x_m >= 0
        is_driven |= _is_swept(track_ego_m, parameters.footprint_width_m / 2, label_grid)
    classes[is_driven & (classes == P)] = T
    return classes


def _is_swept(track_m: Track, radius_m: float, label_grid: LabelGrid) -> NDArray[np.bool_]:
    """Return which columns (X, Y) have their centre within the radius of the track (M, 2) that ends at the robot."""
    track_m = np.vstack([track_m, np.zeros((1, 2))])
    lengths_m = np.linalg.norm(np.diff(track_m, axis=0), axis=1)
    steps = np.concatenate([[0.0], np.cumsum(lengths_m)])
    at_m = np.arange(0.0, steps[-1] + TRACK_STEP_M, TRACK_STEP_M)
    places_m = np.column_stack([np.interp(at_m, steps, track_m[:, axis]) for axis in (0, 1)])
    low_m, shape = np.array(label_grid.min_m[:2]), np.array(label_grid.shape[:2])
    is_swept = np.zeros(label_grid.shape[:2], np.bool_)
    own = np.floor((places_m - low_m) / label_grid.voxel_m).astype(np.intp)
    reach = math.ceil(radius_m / label_grid.voxel_m)
    for step in np.ndindex(2 * reach + 1, 2 * reach + 1):
        columns = own + np.array(step) - reach
        centres_m = (columns + 0.5) * label_grid.voxel_m + low_m
        is_near = np.linalg.norm(centres_m - places_m, axis=1) <= radius_m
        columns = columns[is_near & ((columns >= 0) & (columns < shape)).all(axis=1)]
        is_swept[columns[:, 0], columns[:, 1]] = True
    return is_swept


def column_centres_m(label_grid: LabelGrid = PAPER) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return x (X, 1) and y (1, Y) of the column centres."""
    sides = ((label_grid.min_m[axis], label_grid.shape[axis]) for axis in (0, 1))
    x_m, y_m = (low_m + (np.arange(size) + 0.5) * label_grid.voxel_m for low_m, size in sides)
    return x_m[:, None].astype(np.float64), y_m[None, :].astype(np.float64)


def _measure(points: Heights, label_grid: LabelGrid, grid: Grid) -> Heights:
    """Mark each voxel that contains a point as N, and return the lowest z of each column (inf: none)."""
    lowest = np.full(label_grid.shape[:2], np.inf, np.float32)
    with np.errstate(invalid="ignore", over="ignore"):  # NaN points, which are on no grid
        voxel = (points - np.array(label_grid.min_m)) / label_grid.voxel_m
        is_inside = ((voxel >= 0) & (voxel < np.array(label_grid.shape))).all(axis=1)  # False for NaN
    i, j, k = voxel[is_inside].astype(np.intp).T
    grid[i, j, k] = N
    np.minimum.at(lowest, (i, j), points[is_inside, 2])
    return lowest


def _around(columns: Heights, reach: int, outside: float) -> Iterator[tuple[int, int, Heights]]:
    """Yield the steps along x and y to each neighbour within `reach`, and the values of all columns' neighbours."""
    padded = np.pad(columns, reach, constant_values=outside)
    for a in range(2 * reach + 1):
        for b in range(2 * reach + 1):
            yield a - reach, b - reach, padded[a : a + columns.shape[0], b : b + columns.shape[1]]


def _kept_ground(lowest: Heights, most_rise_m: float) -> Heights:
    """Return the lowest points that are ground: no point within two columns is more than `most_rise_m` lower; otherwise
    NaN.
    """
    around = np.minimum.reduce([near for _, _, near in _around(lowest, 2, np.inf)])
    is_measured = lowest < np.inf
    rise_m = np.subtract(lowest, around, out=np.full_like(lowest, np.inf), where=is_measured)
    return np.where(rise_m <= np.float64(most_rise_m), lowest, np.float32(np.nan))


def _close_gaps(ground: Heights) -> Heights:
    """Set unknown columns with at least two known neighbours of eight to their mean."""
    total, known = np.zeros(ground.shape), np.zeros(ground.shape, np.int64)
    for _, _, near in _around(ground, 1, np.nan):
        is_known = ~np.isnan(near)
        total += np.where(is_known, near, 0)
        known += is_known
    is_closed = np.isnan(ground) & (known >= 2)
    closed = ground.copy()
    closed[is_closed] = total[is_closed] / known[is_closed]
    return closed


def _rise(before: Heights, here: Heights, after: Heights) -> NDArray[np.float64]:
    """Return the height gained per column, from the known neighbours."""
    alone = np.where(np.isnan(after), np.float32(0), after - here).astype(np.float64)
    both = np.where(np.isnan(after), here - before, (after - before).astype(np.float64) / 2)
    return np.where(np.isnan(before), alone, both)


def _is_blocking(ground: Heights, most_rise_m: float, most_uneven_m: float) -> NDArray[np.bool_]:
    """Return whether each known column is too steep, or too uneven relative to its plane through eight neighbours."""
    near = {(a, b): heights for a, b, heights in _around(ground, 1, np.nan)}
    dx = _rise(near[-1, 0], ground, near[1, 0])
    dy = _rise(near[0, -1], ground, near[0, 1])
    uneven = np.zeros(ground.shape)
    for (a, b), heights in near.items():
        uneven = np.fmax(uneven, np.abs(heights - ground - dx * a - dy * b))  # unknown neighbours are NaN and ignored
    return np.asarray((np.sqrt(dx * dx + dy * dy) > most_rise_m) | (uneven > most_uneven_m))


def _paint(grid: Grid, ground: Heights, classes: NDArray[np.uint8], limits: tuple[LabelGrid, float]) -> None:
    """Set the column's class at its ground voxel and measured voxels within the clearance; other voxels stay N."""
    label_grid, clearance_m = limits
    (_, _, min_z_m), voxel_m = label_grid.min_m, label_grid.voxel_m
    i, j, k = np.nonzero(grid)
    height_m = (k + 0.5) * voxel_m + min_z_m
    is_near = (classes[i, j] != FREE) & (np.abs(height_m - ground[i, j]) <= clearance_m)
    i, j, k = i[is_near], j[is_near], k[is_near]
    grid[i, j, k] = classes[i, j]
    i, j = np.nonzero(classes)
    floor = (ground[i, j] - np.float64(min_z_m)) / voxel_m
    is_inside = (floor >= 0) & (floor < grid.shape[2])
    i, j = i[is_inside], j[is_inside]
    grid[i, j, floor[is_inside].astype(np.intp)] = classes[i, j]
