"""The k nearest neighbours of every point, as the plane that fits them best.

**Conventions.** Points are sorted into cubic cells, and the search is exact: it widens ring by ring until the k-th
neighbour is nearer than the border of what was searched, up to the second ring (so at least 2 cell sizes away). A point
counts as its own neighbour, at distance 0. Ties are broken by the order of the sorted points.
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.geometry.lattice import VoxelTable, check_reach, find, keys_of, pack, table_of
from stone.surface.neighbour_search import SEARCHED, fit

AROUND = 27  # a cell and those around it


@dataclass(frozen=True, eq=False)
class Cells:
    """Points sorted by cell: `points[start[c]:start[c+1]]` lie in cell `keys[c]`; `order` leads back to the input."""

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
    """Sort points (N, 3) into cells; raises `OffLatticeError` as `keys_of` does."""
    keys = keys_of(points, size_m)
    order = np.argsort(keys, kind="stable")
    ordered = keys[order]
    first = np.flatnonzero(np.concatenate([[True], ordered[1:] != ordered[:-1]])) if len(keys) else order
    start = np.append(first, len(keys)).astype(np.int64)
    return Cells(size_m, np.ascontiguousarray(points[order]), order, ordered[first], start, table_of(ordered[first]))


def plane_fits(cells: Cells, k: int) -> PlaneFits:
    """Planes through the k nearest neighbours of every point, in the order of the points given to `cells_of`.

    The plane is the total least-squares one: the mean square is the smallest eigenvalue of the neighbours'
    covariance, the normal (sign arbitrary, zero where there is no plane) its eigenvector.
    """
    fits = _fits(cells, (cells.points, cells.start), k)
    back = np.empty(len(cells.order), np.int64)
    back[cells.order] = np.arange(len(cells.order))
    return PlaneFits(fits.mean_square_m2[back], fits.normals[back])


def plane_fits_at(cells: Cells, places: NDArray[np.float64], k: int) -> PlaneFits:
    """The same around one place in each cell (C, 3) instead of around every point."""
    return _fits(cells, (np.ascontiguousarray(places), np.arange(len(cells.keys) + 1)), k)


def _fits(cells: Cells, asked: tuple[NDArray[np.float64], NDArray[np.int64]], k: int) -> PlaneFits:
    """Around the places asked (Q, 3), those of cell c being asked[1][c] to asked[1][c + 1]."""
    mean_square = np.empty(len(asked[0]))
    normals = np.zeros((len(asked[0]), 3))
    crowd = int(np.diff(cells.start).max(initial=0))
    room = k + min(len(cells.points), SEARCHED * crowd)
    fit((cells.points, *asked), (cells.keys, cells.start, cells.size_m), k, room, (mean_square, normals))
    return PlaneFits(mean_square, normals)


def is_near(queries: NDArray[np.float64], points: NDArray[np.float64], radius_m: float) -> NDArray[np.bool_]:
    """Which queries (Q, 3) have one of the points (N, 3) within `radius_m` (inclusive)."""
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
    """Append the point ranges of the cells exactly `ring` cells away; the new number of spans."""
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
    """Whether a point of these ranges is within the root of `square` of a place."""
    for s in range(filled):
        for b in range(spans[s, 0], spans[s, 1]):
            if (points[b, 0] - at[0]) ** 2 + (points[b, 1] - at[1]) ** 2 + (points[b, 2] - at[2]) ** 2 <= square:
                return True
    return False


@njit(cache=True, nogil=True)
def _near(queries, points, start, table, radius_m, near):  # type: ignore[no-untyped-def]
    """The query's own cell is looked at first: most that are near are so there already."""
    spans = np.empty((AROUND, 2), np.int64)
    square = radius_m * radius_m
    for q in range(queries.shape[0]):
        at = queries[q, 0], queries[q, 1], queries[q, 2]
        cell = (math.floor(at[0] / radius_m), math.floor(at[1] / radius_m), math.floor(at[2] / radius_m))
        near[q] = _has_near(points, spans, _collect(cell, 0, start, table, spans, 0), at, square)
        if not near[q]:
            near[q] = _has_near(points, spans, _collect(cell, 1, start, table, spans, 0), at, square)
