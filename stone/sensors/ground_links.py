"""Drift of a run's poses in z, measured by the ground: the height difference between two looks at the same place.

    ground seen around a pose → links of poses that saw the same ground → one correction in z for every pose

**Conventions.** A look is one sweep's ground in cells of the map's plan; poses are selected `SPACING_M` apart. A link
is the height of its second look's ground above its first look's, in the cells that both contain. It uses the median, so
that movers and hedges have no effect, and both directions equally, so that range-dependent errors cancel. Corrections
are metres added to z; the first look of each map is not corrected.

A tilted mount also looks like drift, because each look sees the ground ahead too high. If the ground is tilted in the
ego frame beyond `TERRAIN_RAD`, looks are also compared with that tilt removed, and the variant with the smaller
correction is used.
"""

import math
from collections.abc import Sequence as Listing
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.geometry.lattice import EMPTY, indices_of, pack
from stone.sensors.ground_points import FARTHEST_M, low_points
from stone.sensors.height_drift import HeightDrift

SPACING_M, WIDEST_SPACING_M, MANY_LOOKS = 2.0, 8.0, 600
CELL_M = 0.5
FEWEST_CELLS, MOST_SCATTER_M = 40, 0.15
PARTNERS_BEFORE, PARTNERS_OF_VISITS = 5, 6
TERRAIN_RAD = float(np.deg2rad(0.5))
# Two floors are farther apart than the robot's height; ground at a smaller distance is the same floor.
SAME_FLOOR_RATIO, LEAST_FLOOR_M = 0.8, 0.3
ROUNDS, ROBUST_M, STIFFNESS = 8, 0.02, 0.02
FARTHEST_PLACE_M = 100_000.0

Array = NDArray[np.float64]
Rows = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Look:
    """The ground around one pose: cells (C,) of the map's plan, sorted, and their heights (C,)."""

    cells: Rows
    heights_m: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Way:
    """For every look: its position in plan (K, 2), the distance driven until then (K,), and its map (K,)."""

    places_m: Array
    driven_m: Array
    maps: Rows


@dataclass(frozen=True, eq=False)
class Links:
    """Pairs (L, 2) of looks at the same ground, the height of the second above the first (L,), and the centre (L, 2) in
    plan of their common cells.
    """

    pairs: Rows
    height_m: Array
    middle_m: Array


def looks_along(places_m: Array) -> Rows:
    """Return the positions (N, 2) or (N, 3) along a track with a look: the first, and one every `SPACING_M` (a larger
    spacing for long tracks).
    """
    driven_m = driven(places_m)
    spacing_m = min(max(SPACING_M, float(driven_m[-1]) / MANY_LOOKS), WIDEST_SPACING_M)
    return np.unique(np.searchsorted(driven_m, np.arange(0.0, driven_m[-1] + 1e-9, spacing_m))).astype(np.int64)


def driven(places_m: Array) -> Array:
    """Return the distance driven, in plan, until each of the positions (N, 2) or (N, 3)."""
    return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(places_m[:, :2], axis=0), axis=1)))


def look(points_map: Array) -> Look:
    """Return the ground in the points (N, 3) of a sweep around the robot, in the map."""
    cell = np.empty(len(points_map), np.int64)
    if _plan_cells(points_map, cell):
        is_on_lattice = cell != EMPTY
        points_map, cell = points_map[is_on_lattice], cell[is_on_lattice]
    cells, lowest = low_points(points_map, cell)
    return Look(cells, lowest[:, 2].astype(np.float32))


def links_between(looks: Listing[Look], way: Way) -> Links:
    """Return the links of the looks (K,) along a track."""
    pairs = _pairs(way)
    differences = np.array([_higher(looks[a], looks[b]) for a, b in pairs.tolist()]).reshape(-1, 3)
    is_found = np.isfinite(differences[:, 0])
    return Links(pairs[is_found], differences[is_found, 0], differences[is_found, 1:])


def of_one_visit(links: Links, way: Way) -> NDArray[np.bool_]:
    """Return which of the links (L,) connect consecutive looks."""
    return np.asarray(np.diff(way.driven_m[links.pairs], axis=1)[:, 0] <= 2 * FARTHEST_M)


def drift(links: Links, way: Way, floor_m: float) -> tuple[HeightDrift, Array]:
    """Return the drift from the links, and the correction (K,) of each look.

    Passes whose ground is more than `floor_m` apart, after correction of the track between them, are on two floors and
    are ignored.
    """
    pairs, height_m, is_near = links.pairs, links.height_m, of_one_visit(links, way)
    found_m = _corrections(pairs[is_near], height_m[is_near], way)
    off_m = np.abs(height_m + np.diff(found_m[pairs], axis=1)[:, 0])
    is_same = is_near | (off_m <= floor_m)
    pairs, height_m, is_near = pairs[is_same], height_m[is_same], is_near[is_same]
    found_m = found_m if is_near.all() else _corrections(pairs, height_m, way)
    return _told(height_m, np.diff(found_m[pairs], axis=1)[:, 0], is_near, (found_m, way)), found_m


def _told(height_m: Array, moved_m: Array, is_near: NDArray[np.bool_], looks: tuple[Array, Way]) -> HeightDrift:
    """Return the drift from links (L,): the height of each second look above the first, and its correction relative to
    the first.
    """
    found_m, way = looks
    apart_m, left_m = np.abs(moved_m), np.abs(height_m + moved_m)
    return HeightDrift(
        len(found_m),
        len(height_m),
        apart_m=float(apart_m.max(initial=0.0)),
        visit_apart_m=float(apart_m[is_near].max(initial=0.0)),
        left_m=float(np.quantile(left_m, 0.95)) if len(left_m) else 0.0,
        span_m=float(np.ptp(found_m)),
        driven_m=float(np.ptp(way.driven_m)),
    )


def _pairs(way: Way) -> Rows:
    """Return the pairs (L, 2) of looks of one map that may see the same ground: recent looks and looks of earlier
    visits.
    """
    from scipy.spatial import cKDTree  # a lazy import: `stone inspect` rarely needs it

    tree = cKDTree(way.places_m)
    pairs = [
        (before, row)
        for row, near in enumerate(tree.query_ball_point(way.places_m, FARTHEST_M, return_sorted=True))
        for before in _partners(np.array([look for look in near if look < row], np.int64))
        if way.maps[before] == way.maps[row]
    ]
    return np.array(pairs, np.int64).reshape(-1, 2)


def _partners(before: Rows) -> list[int]:
    """Return the last of the earlier looks, and a few spread over the others."""
    last, others = before[-PARTNERS_BEFORE:], before[:-PARTNERS_BEFORE]
    spread = np.linspace(0, len(others) - 1, PARTNERS_OF_VISITS).round().astype(np.int64) if len(others) else others
    return [*np.unique(others[spread]).tolist(), *last.tolist()]


def _higher(first: Look, second: Look) -> tuple[float, float, float]:
    """Return the height of the second look's ground above the first's, and the position; NaN if little is shared or it
    scatters.
    """
    cells, mine, theirs = np.intersect1d(first.cells, second.cells, assume_unique=True, return_indices=True)
    if len(mine) < FEWEST_CELLS:
        return np.nan, np.nan, np.nan
    off_m = second.heights_m[theirs].astype(np.float64) - first.heights_m[mine]
    middle_m = float(np.median(off_m))
    x_m, y_m = ((indices_of(cells)[:, :2] + 0.5) * CELL_M).mean(axis=0).tolist()
    is_one = float(np.median(np.abs(off_m - middle_m))) <= MOST_SCATTER_M
    return (middle_m if is_one else np.nan), x_m, y_m


def _corrections(pairs: Rows, height_m: Array, way: Way) -> Array:
    """Return the corrections (K,) that fit the links best, with a smaller weight for outliers; unlinked looks keep
    their previous correction.
    """
    count = len(way.maps)
    is_new = np.append(True, np.diff(way.maps) != 0)
    chain = np.column_stack([np.arange(count - 1), np.arange(1, count)])[~is_new[1:]]
    first = np.flatnonzero(is_new)
    found_m, weight = np.zeros(count), np.ones(len(pairs))
    for _ in range(ROUNDS if len(pairs) else 0):
        edges = np.concatenate([pairs, chain])
        force = np.concatenate([weight, np.full(len(chain), STIFFNESS)])
        pull = np.concatenate([-weight * height_m, np.zeros(len(chain))])
        found_m = _solved((edges, force, pull), first, count)
        off_m = np.abs(height_m + np.diff(found_m[pairs], axis=1)[:, 0])
        weight = ROBUST_M / np.maximum(off_m, ROBUST_M)
    return found_m


def _solved(springs: tuple[Rows, Array, Array], fixed: Rows, count: int) -> Array:
    """Return the equilibrium positions (K,) of springs between pairs, with those of `fixed` at 0."""
    from scipy.sparse import coo_array
    from scipy.sparse.linalg import spsolve

    edges, force, pull = springs
    a, b = edges.T
    rows, columns = np.concatenate([a, b, a, b, fixed]), np.concatenate([a, b, b, a, fixed])
    values = np.concatenate([force, force, -force, -force, np.full(len(fixed), 1e6)])
    right = np.bincount(b, pull, count) - np.bincount(a, pull, count)
    return np.asarray(spsolve(coo_array((values, (rows, columns)), shape=(count, count)).tocsc(), right))


@njit(cache=True, nogil=True)
def _plan_cells(points, cell):  # type: ignore[no-untyped-def]
    """Write the key of each point's cell in plan, `EMPTY` for points off the lattice; return the number of keys."""
    off, inverse = 0, 1.0 / CELL_M
    for p in range(points.shape[0]):
        x, y = points[p, 0], points[p, 1]
        if abs(x) < FARTHEST_PLACE_M and abs(y) < FARTHEST_PLACE_M and np.isfinite(points[p, 2]):
            cell[p] = pack(math.floor(x * inverse), math.floor(y * inverse), 0)
        else:
            cell[p] = EMPTY
            off += 1
    return off
