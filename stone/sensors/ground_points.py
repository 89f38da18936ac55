"""The ground in one sweep around the robot: its points, the low point of each cell in plan, and their plane.

**Conventions.** A plane is (height_m, slope_x, slope_y), as in `stone.sensors.ground_plane`. A cell's low point is at
`LOW_QUANTILE` of height, so that vegetation above and stray returns below have no effect. Ties in height go to the
first point. Only cells are sorted.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.geometry.lattice import EMPTY, slot_of

NEAREST_M, FARTHEST_M = 0.8, 12.0
LOWEST_M, HIGHEST_M = -2.5, 1.5
LOW_QUANTILE, FEWEST_IN_CELL = 0.3, 3
SLACK_RATIO = 1e-12  # more than the rounding of a squared distance
CELL_M = 0.3
FEWEST_CELLS, FULL_SHARE = 24, 0.2
REACHES_M = (2.5, 3.0, 4.0, 6.0, 8.0, FARTHEST_M)  # the nearest range with enough cells is used, because terrain bends
TRIPLES, INLIER_M, STEEPEST = 200, 0.08, 0.35  # tan 19°: steeper surfaces are not usable as ground
LEAST_INLIERS = 0.4
FITS, FAR_M = 12, 0.15
SEED = 17

Array = NDArray[np.float64]
Rows = NDArray[np.int64]


def around_robot(points_ego: NDArray[np.float32]) -> Array:
    """Return the points (N, 3) that may be ground near the robot."""
    near = np.empty((len(points_ego), 3))
    count, doubtful = _near(points_ego, near)
    points = near[:count]
    if not doubtful:
        return points
    far_m = np.hypot(points[:, 0], points[:, 1])
    return np.asarray(points[(far_m >= NEAREST_M) & (far_m <= FARTHEST_M)])


def low_points(points: Array, cell: Rows) -> tuple[Rows, Array]:
    """Return the cells (C,) with at least `FEWEST_IN_CELL` of the points (N, 3), sorted, and the low point (C, 3) of
    each.

    `cell` (N,) ≥ 0 is the cell of each point.
    """
    slots = 1 << (2 * len(cell) + 1).bit_length()
    number, cells = np.empty(len(cell), np.int64), np.empty(len(cell), np.int64)
    taken, numbers = np.full(slots, EMPTY, np.int64), np.empty(slots, np.int64)
    cells = cells[: _number(cell, taken, numbers, (number, cells))]
    counts = np.bincount(number, minlength=len(cells))
    begin = np.cumsum(counts) - counts
    rows, lowest = np.empty(len(cell), np.int64), np.empty(len(cells), np.int64)
    _group(number, begin.copy(), rows)
    ranks = begin + (LOW_QUANTILE * (counts - 1)).astype(np.int64)
    _select(np.ascontiguousarray(points[:, 2]), (begin, begin + counts - 1, ranks), rows, lowest)
    order = np.argsort(cells)
    order = order[counts[order] >= FEWEST_IN_CELL]
    return cells[order], np.asarray(points[lowest[order]])


def plane_around(points_ego: NDArray[np.float32]) -> Array | None:
    """Return (height_m, slope_x, slope_y) of the ground around the robot from the points (N, 3) of one sweep.

    Return None if too little ground is visible, or no plane fits.
    """
    cells = _lowest(points_ego)
    around = [cells[np.hypot(cells[:, 0], cells[:, 1]) <= reach_m] for reach_m in REACHES_M]
    shown = [near for near in around if len(near) >= FEWEST_CELLS and _is_around(near)]
    full = [near for near, reach_m in zip(around, REACHES_M, strict=True) if _share(near, reach_m) >= FULL_SHARE]
    chosen = [near for near in full if _is_around(near)] or shown
    return _plane(chosen[0]) if chosen else None


def _share(cells: Array, reach_m: float) -> float:
    """Return the cells' share of the plan within reach; a small share may be objects beside the robot."""
    return len(cells) * CELL_M**2 / (np.pi * reach_m**2)


def _lowest(points_ego: NDArray[np.float32]) -> Array:
    """Return the low points (C, 3) of cells around the robot."""
    points = around_robot(points_ego)
    index = np.floor(points[:, :2] / CELL_M).astype(np.int64) + 1000
    return low_points(points, index[:, 0] * 10_000 + index[:, 1])[1]


def _is_around(cells: Array) -> bool:
    """Return whether cells lie on at least three of the robot's four sides; a plane on one side is not the ground under
    it.
    """
    sides = np.floor((np.arctan2(cells[:, 1], cells[:, 0]) + np.pi) / (np.pi / 2)).astype(np.int64) % 4
    return len(np.unique(sides)) >= 3


def _plane(cells: Array) -> Array | None:
    """Return the plane that most cells lie on, by triples of cells, then robust least squares; None below a share."""
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
        root = np.clip(1.0 - np.square(off_m / FAR_M), 0.0, None)  # Tukey's biweight: cells enter and leave smoothly
        plane = np.linalg.lstsq(everywhere * root[:, None], cells[:, 2] * root, rcond=None)[0]
    return np.asarray(plane)


@njit(cache=True, nogil=True)
def _near(points, near):  # type: ignore[no-untyped-def]
    """Write the points that may be near; return their number, and the number of points too close to a limit to
    decide.
    """
    count, doubtful = np.int64(0), np.int64(0)
    least, most = NEAREST_M * NEAREST_M * (1 - SLACK_RATIO), FARTHEST_M * FARTHEST_M * (1 + SLACK_RATIO)
    sure_least, sure_most = NEAREST_M * NEAREST_M * (1 + SLACK_RATIO), FARTHEST_M * FARTHEST_M * (1 - SLACK_RATIO)
    for p in range(points.shape[0]):
        x, y, z = np.float64(points[p, 0]), np.float64(points[p, 1]), np.float64(points[p, 2])
        far_m2 = x * x + y * y
        near[count, 0], near[count, 1], near[count, 2] = x, y, z
        is_near = (far_m2 >= least) & (far_m2 <= most) & (z >= LOWEST_M) & (z <= HIGHEST_M)
        count += is_near
        doubtful += is_near & ((far_m2 < sure_least) | (far_m2 > sure_most))
    return count, doubtful


@njit(cache=True, nogil=True)
def _number(cell, taken, numbers, out):  # type: ignore[no-untyped-def]
    """Write each point's cell number, in order of appearance, and each number's cell; return the number of cells."""
    number, cells = out
    count = 0
    for p in range(cell.size):
        slot = slot_of(taken, cell[p])
        if taken[slot] == EMPTY:
            taken[slot], numbers[slot], cells[count] = cell[p], count, cell[p]
            count += 1
        number[p] = numbers[slot]
    return count


@njit(cache=True, nogil=True)
def _group(number, following, rows):  # type: ignore[no-untyped-def]
    """Fill `rows` with the points cell by cell, in their order; `following` are the cells' starts."""
    for p in range(number.size):
        rows[following[number[p]]] = p
        following[number[p]] += 1


@njit(cache=True, nogil=True)
def _select(heights, ranges, rows, lowest):  # type: ignore[no-untyped-def]
    """Write the row that would be at its rank if each range of rows (both ends included) were sorted (Hoare, 1961)."""
    firsts, lasts, ranks = ranges
    for c in range(ranks.size):
        first, last, rank = firsts[c], lasts[c], ranks[c]
        while first < last:
            pivot = rows[(first + last) >> 1]
            i, j = first, last
            while i <= j:
                while _is_lower(heights, rows[i], pivot):
                    i += 1
                while _is_lower(heights, pivot, rows[j]):
                    j -= 1
                if i <= j:
                    rows[i], rows[j] = rows[j], rows[i]
                    i += 1
                    j -= 1
            first, last = (first, j) if rank <= j else (i, last) if rank >= i else (rank, rank)
        lowest[c] = rows[rank]


@njit(inline="always")
def _is_lower(heights, a, b):  # type: ignore[no-untyped-def]
    return heights[a] < heights[b] or (heights[a] == heights[b] and a < b)
