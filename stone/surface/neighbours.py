"""The k nearest neighbours of every point, as their best-fitting plane.

**Conventions.** Points are sorted into cubic cells. The exact search expands by rings until the k-th neighbour is
nearer than the border of the searched cells, up to the second ring (at least 2 cell sizes away). A point is its own
neighbour at distance 0. Ties are resolved by the order of the sorted points.
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.geometry.lattice import BIAS, MASK, VoxelTable, check_reach, find, keys_of, pack, table_of

AROUND = 27  # a cell and its neighbours


@dataclass(frozen=True, eq=False)
class Cells:
    """Points sorted by cell: `points[start[c]:start[c+1]]` are in cell `keys[c]`; `order` maps back to the input."""

    size_m: float
    points: NDArray[np.float64]
    order: NDArray[np.int64]
    keys: NDArray[np.int64]
    start: NDArray[np.int64]
    table: VoxelTable


@dataclass(frozen=True, eq=False)
class PlaneFits:
    """Per point: mean squared distance (m²) of its neighbours to their plane (NaN below `FEWEST`) and its normal."""

    mean_square_m2: NDArray[np.float64]
    normals: NDArray[np.float64]


def cells_of(points: NDArray[np.float64], size_m: float) -> Cells:
    """Sort points (N, 3) into cells. Raises `off_lattice` like `keys_of`."""
    keys = keys_of(points, size_m)
    order = np.argsort(keys, kind="stable")
    ordered = keys[order]
    first = np.flatnonzero(np.concatenate([[True], ordered[1:] != ordered[:-1]])) if len(keys) else order
    start = np.append(first, len(keys)).astype(np.int64)
    return Cells(size_m, np.ascontiguousarray(points[order]), order, ordered[first], start, table_of(ordered[first]))


def plane_fits(cells: Cells, k: int) -> PlaneFits:
    """Return planes through the k nearest neighbours of every point, in the order of the points given to `cells_of`.

    It is the total least squares plane: the mean square is the smallest eigenvalue of the neighbours' covariance, the
    normal (arbitrary sign, zero without a plane) its eigenvector.
    """
    fits = _fits(cells, (cells.points, cells.start), k)
    back = np.empty(len(cells.order), np.int64)
    back[cells.order] = np.arange(len(cells.order))
    return PlaneFits(fits.mean_square_m2[back], fits.normals[back])


def plane_fits_at(cells: Cells, places: NDArray[np.float64], k: int) -> PlaneFits:
    """Return the planes around one position in each cell (C, 3) instead of around every point."""
    return _fits(cells, (np.ascontiguousarray(places), np.arange(len(cells.keys) + 1)), k)


def _fits(cells: Cells, requested: tuple[NDArray[np.float64], NDArray[np.int64]], k: int) -> PlaneFits:
    """Return the planes around the requested positions (Q, 3); cell c has asked[1][c] to asked[1][c + 1]."""
    mean_square = np.empty(len(requested[0]))
    normals = np.zeros((len(requested[0]), 3))
    crowd = int(np.diff(cells.start).max(initial=0))
    room = k + min(len(cells.points), SEARCHED * crowd)
    fit((cells.points, *requested), (cells.keys, cells.start, cells.size_m), k, room, (mean_square, normals))
    return PlaneFits(mean_square, normals)


def is_near(queries: NDArray[np.float64], points: NDArray[np.float64], radius_m: float) -> NDArray[np.bool_]:
    """Return which queries (Q, 3) have one of the points (N, 3) within `radius_m` (inclusive)."""
    near = np.zeros(len(queries), np.bool_)
    if len(points) and len(queries):
        cells = cells_of(points, radius_m)
        check_reach(queries, radius_m)
        _near(
            np.ascontiguousarray(queries),
            cells.points,
            cells.start,
            (cells.table.keys, cells.table.rows),
            radius_m,
            near,
        )
    return near


@njit(cache=True, nogil=True)
def _collect(cell, ring, start, table, spans, filled):  # type: ignore[no-untyped-def]
    """Append the point ranges of the cells exactly `ring` cells away; return the new number of ranges."""
    ci, cj, ck = cell
    for di in range(-ring, ring + 1):
        for dj in range(-ring, ring + 1):
            for dk in range(-ring, ring + 1):
                if max(abs(di), abs(dj), abs(dk)) != ring:
                    continue
                row = find(table[0], table[1], pack(ci + di, cj + dj, ck + dk))
                if row >= 0:
                    spans[filled, 0], spans[filled, 1] = start[row], start[row + 1]
                    filled += 1
    return filled


@njit(inline="always")
def _has_near(points, spans, filled, at, square):  # type: ignore[no-untyped-def]
    """Return whether a point of these ranges is within the root of `square` of a position."""
    for s in range(filled):
        for b in range(spans[s, 0], spans[s, 1]):
            if (points[b, 0] - at[0]) ** 2 + (points[b, 1] - at[1]) ** 2 + (points[b, 2] - at[2]) ** 2 <= square:
                return True
    return False


@njit(cache=True, nogil=True)
def _near(queries, points, start, table, radius_m, near):  # type: ignore[no-untyped-def]
    """Mark near queries; the query's own cell is searched first, because most are near in it."""
    spans = np.empty((AROUND, 2), np.int64)
    square = radius_m * radius_m
    for q in range(queries.shape[0]):
        at = queries[q, 0], queries[q, 1], queries[q, 2]
        cell = (math.floor(at[0] / radius_m), math.floor(at[1] / radius_m), math.floor(at[2] / radius_m))
        near[q] = _has_near(points, spans, _collect(cell, 0, start, table, spans, 0), at, square)
        if not near[q]:
            near[q] = _has_near(points, spans, _collect(cell, 1, start, table, spans, 0), at, square)


# The search for the k nearest points around positions, cell by cell, and the plane through them. Cells come in key
# order, and a cell's points are consecutive. Results are sorted by distance; ties keep the search order: the nine
# columns of surrounding cells, then cells two away. Candidates are collected in bins by squared distance, so that only
# the bins of the k nearest are sorted.


FEWEST = 4  # three points always lie on a plane and give no information
BINS, WIDEST_CELLS = 64, 2.0  # bins of equal squared distance up to this number of cells; the last contains the rest
SLACK = 1.0 + 1e-6  # more than the rounding of a squared distance
SEARCHED = 125  # cells up to two away


@njit(inline="always")
def smallest_eigenvalue(a00, a01, a02, a11, a12, a22):  # type: ignore[no-untyped-def]
    """Return the smallest eigenvalue of a symmetric 3 × 3 matrix in closed form (Smith, 1961)."""
    off = a01 * a01 + a02 * a02 + a12 * a12
    q = (a00 + a11 + a22) / 3.0
    p = math.sqrt(((a00 - q) ** 2 + (a11 - q) ** 2 + (a22 - q) ** 2 + 2.0 * off) / 6.0)
    if p < 1e-150:
        return q
    b00, b11, b22 = (a00 - q) / p, (a11 - q) / p, (a22 - q) / p
    b01, b02, b12 = a01 / p, a02 / p, a12 / p
    r = 0.5 * (b00 * (b11 * b22 - b12 * b12) - b01 * (b01 * b22 - b12 * b02) + b02 * (b01 * b12 - b11 * b02))
    angle = math.acos(min(1.0, max(-1.0, r))) / 3.0
    return q + 2.0 * p * math.cos(angle + 2.0943951023931953)


@njit(inline="always")
def eigenvector(a00, a01, a02, a11, a12, a22, value):  # type: ignore[no-untyped-def]
    """Return the unit eigenvector of a symmetric 3 × 3 matrix: the longest cross product of two rows of A − λ."""
    x, y, z = a00 - value, a11 - value, a22 - value
    u0, u1, u2 = a01 * a12 - a02 * y, a02 * a01 - x * a12, x * y - a01 * a01
    v0, v1, v2 = a01 * z - a02 * a12, a02 * a02 - x * z, x * a12 - a01 * a02
    w0, w1, w2 = y * z - a12 * a12, a12 * a02 - a01 * z, a01 * a12 - a02 * y
    nu, nv, nw = u0 * u0 + u1 * u1 + u2 * u2, v0 * v0 + v1 * v1 + v2 * v2, w0 * w0 + w1 * w1 + w2 * w2
    if nv > nu and nv >= nw:
        u0, u1, u2, nu = v0, v1, v2, nv
    elif nw > nu:
        u0, u1, u2, nu = w0, w1, w2, nw
    s = 1.0 / math.sqrt(nu + 1e-300)
    return u0 * s, u1 * s, u2 * s


@njit(cache=True, nogil=True)
def _plane(points, at, best, count):  # type: ignore[no-untyped-def]
    """Return (mean square distance, normal) of the first `count` neighbours."""
    s0 = s1 = s2 = c00 = c01 = c02 = c11 = c12 = c22 = 0.0
    for t in range(count):
        b = best[1][t]
        x, y, z = points[b, 0] - at[0], points[b, 1] - at[1], points[b, 2] - at[2]
        s0, s1, s2 = s0 + x, s1 + y, s2 + z
        c00, c01, c02 = c00 + x * x, c01 + x * y, c02 + x * z
        c11, c12, c22 = c11 + y * y, c12 + y * z, c22 + z * z
    w = 1.0 / count
    s0, s1, s2 = s0 * w, s1 * w, s2 * w
    a00, a01, a02 = c00 * w - s0 * s0, c01 * w - s0 * s1, c02 * w - s0 * s2
    a11, a12, a22 = c11 * w - s1 * s1, c12 * w - s1 * s2, c22 * w - s2 * s2
    value = smallest_eigenvalue(a00, a01, a02, a11, a12, a22)
    n0, n1, n2 = eigenvector(a00, a01, a02, a11, a12, a22, value)
    return max(value, 0.0), n0, n1, n2


@njit(inline="always")
def _advance(keys, target, row):  # type: ignore[no-untyped-def]
    """Return the first row, from `row`, whose key is not below `target`."""
    while row < keys.size and keys[row] < target:
        row += 1
    return row


@njit(cache=True, nogil=True)
def _open_columns(keys, key, reach, columns):  # type: ignore[no-untyped-def]
    """Advance the row ranges of the square of columns around a cell, each `reach` cells up and down, to this cell.

    Cells come in key order and neighbours are a fixed step away, so every range only moves forward.
    """
    at = 0
    for di in range(-reach, reach + 1):
        for dj in range(-reach, reach + 1):
            target = key + (np.int64(di) << 42) + (np.int64(dj) << 21)
            columns[at, 0] = _advance(keys, target - reach, columns[at, 0])
            columns[at, 1] = _advance(keys, target + reach + 1, max(columns[at, 0], columns[at, 1]))
            at += 1


@njit(cache=True, nogil=True)
def _gather(points, rows, at, candidates, count):  # type: ignore[no-untyped-def]
    """Append the points of a range with their squared distances; return the new number."""
    distances, numbers = candidates
    for b in range(rows[0], rows[1]):
        distances[count] = (points[b, 0] - at[0]) ** 2 + (points[b, 1] - at[1]) ** 2 + (points[b, 2] - at[2]) ** 2
        numbers[count] = b
        count += 1
    return count


@njit(cache=True, nogil=True)
def _gather_nearer(points, rows, at, candidates, count, limit):  # type: ignore[no-untyped-def]
    """Append only the points nearer than `limit` (squared); return the new number."""
    distances, numbers = candidates
    for b in range(rows[0], rows[1]):
        d = (points[b, 0] - at[0]) ** 2 + (points[b, 1] - at[1]) ** 2 + (points[b, 2] - at[2]) ** 2
        distances[count], numbers[count] = d, b
        count += d < limit
    return count


@njit(cache=True, nogil=True)
def _gather_ring(points, start, columns, position, candidates, count, limit):  # type: ignore[no-untyped-def]
    """Append points two cells away and nearer than `limit`: all of the outer columns, and the ends of the columns
    searched before. Columns whose side is farther than the limit are skipped.
    """
    (near, wide), (at, sides) = columns, position
    for column in range(25):
        i, j = column // 5 - 1, column % 5 - 1
        first, end = wide[column, 0], wide[column, 1]
        if 0 <= i < 3 and 0 <= j < 3:
            inner = near[3 * i + j]
            count = _gather_nearer(points, (start[first], start[inner[0]]), at, candidates, count, limit)
            count = _gather_nearer(points, (start[inner[1]], start[end]), at, candidates, count, limit)
            continue
        x_m = sides[0] if i < 0 else sides[1] if i > 2 else 0.0
        y_m = sides[2] if j < 0 else sides[3] if j > 2 else 0.0
        if x_m * x_m + y_m * y_m <= limit * SLACK:
            count = _gather_nearer(points, (start[first], start[end]), at, candidates, count, limit)
    return count


@njit(cache=True, nogil=True)
def _keep_nearest(candidates, count, k, size_m, best):  # type: ignore[no-untyped-def]
    """Write the nearest k candidates, sorted; return their number."""
    (distances, numbers), (kept, rows, bins) = candidates, best
    scale = BINS / (WIDEST_CELLS * size_m) ** 2
    for b in range(BINS):
        bins[b] = 0
    for t in range(count):
        bins[int(min(distances[t] * scale, BINS - 1.0))] += 1
    total, last = 0, BINS - 1
    for b in range(BINS):
        bins[b], total = total, total + bins[b]
        if total >= k:
            last = b
            break
    for t in range(count):
        own = int(min(distances[t] * scale, BINS - 1.0))
        if own <= last:
            kept[bins[own]], rows[bins[own]] = distances[t], numbers[t]
            bins[own] += 1
    for t in range(1, total):
        d, row, slot = kept[t], rows[t], t
        while slot > 0 and kept[slot - 1] > d:
            kept[slot], rows[slot] = kept[slot - 1], rows[slot - 1]
            slot -= 1
        kept[slot], rows[slot] = d, row
    return min(total, k)


@njit(cache=True, nogil=True)
def _sides(key, size_m, at):  # type: ignore[no-untyped-def]
    """Return the distance to the cells two away, below and above along x and y; and the smallest, including z."""
    x_m = at[0] - ((key >> 42) - BIAS) * size_m
    y_m = at[1] - (((key >> 21) & MASK) - BIAS) * size_m
    z_m = at[2] - ((key & MASK) - BIAS) * size_m
    border = size_m * 2.0
    for inside in (x_m, y_m, z_m):
        border = min(border, size_m + min(inside, size_m - inside))
    return (size_m + x_m, 2.0 * size_m - x_m, size_m + y_m, 2.0 * size_m - y_m), border


@njit(cache=True, nogil=True)
def fit(requested, cells, k, room, out):  # type: ignore[no-untyped-def]
    """Fill mean squares and normals of the planes through the k points nearest to each requested position; `room` fits
    all candidates of any search, plus k.
    """
    points, places, first = requested
    keys, start, size_m = cells
    mean_square, normals = out
    near, wide = np.zeros((9, 2), np.int64), np.zeros((25, 2), np.int64)
    candidates = (np.empty(room), np.empty(room, np.int64))
    best = (np.empty(room), np.empty(room, np.int64), np.empty(BINS, np.int64))
    for c in range(keys.size):
        _open_columns(keys, keys[c], 1, near)
        is_wide_open = False
        for a in range(first[c], first[c + 1]):
            at = (places[a, 0], places[a, 1], places[a, 2])
            count = 0
            for column in range(9):
                count = _gather(points, (start[near[column, 0]], start[near[column, 1]]), at, candidates, count)
            count = _keep_nearest(candidates, count, k, size_m, best)
            sides, border = _sides(keys[c], size_m, at)
            limit = best[0][k - 1] if count == k else np.inf
            if limit > border * border:
                if not is_wide_open:
                    _open_columns(keys, keys[c], 2, wide)
                    is_wide_open = True
                for t in range(count):
                    candidates[0][t], candidates[1][t] = best[0][t], best[1][t]
                count = _gather_ring(points, start, (near, wide), (at, sides), candidates, count, limit)
                count = _keep_nearest(candidates, count, k, size_m, best)
            if count < FEWEST:
                mean_square[a] = np.nan
                continue
            mean_square[a], normals[a, 0], normals[a, 1], normals[a, 2] = _plane(points, at, best, count)
