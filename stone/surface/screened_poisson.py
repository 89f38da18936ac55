"""Screened Poisson reconstruction on the band of the lattice near the data.

The field φ minimises, with ∇φ for the difference along each edge of the lattice (Kazhdan & Hoppe, 2013, Eq. 2),

    Σ_edges (∇φ − N)² · w²  +  α Σ_patches c · φ(p)²

N is the mean of the patches' normals around the edge, p a patch's point, and φ(p) trilinear between the cell's corners.
The weight c is its number of points, up to `FULL_POINTS`, over `FULL_POINTS`. The surface is φ = 0. Two things differ
from the octree solvers. N has unit length throughout the band, so φ is a distance instead of an indicator, and sparse
data need no coarser cells. The domain ends a cell beyond the data, with the natural boundary (the rest would be trimmed
anyway), so φ depends only on nearby data, not on distant cells.

**Conventions.** φ in metres, positive on the side from which the data were seen, one value per corner of the band. Sums
run in patch order, so equal patches give equal bits.
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.geometry.lattice import BIAS, MASK, find, pack
from stone.surface.contour import ABOVE, BELOW, Band
from stone.surface.patches import Patches

FULL_POINTS = 4  # a cell on a surface contains about this number of the map's 0.1 m voxels
MOST_ROUNDS = 2000
NORMAL, DISTANCE = slice(0, 3), 3


@dataclass(frozen=True)
class PoissonParameters:
    """`screening` is α; normals are averaged by a Gaussian of `blur_ratio` cells.

    Iterations end if the residual (preconditioned, root mean square) is below `tolerance_ratio` cells.
    """

    screening: float = 8.0
    blur_ratio: float = 0.75
    tolerance_ratio: float = 1e-5


@dataclass(frozen=True)
class Descent:
    """The end of the solver: number of iterations (at most `MOST_ROUNDS`) and residual in cells.

    The residual is recomputed from the field, because the recursive residual shrinks even if the field stagnates.
    """

    rounds: int = 0
    residual_ratio: float = 0.0


NOT_SOLVED = Descent()


@dataclass(frozen=True, eq=False)
class SolvedField:
    """φ (N,) at the corners of the band, and the solver's convergence."""

    values: NDArray[np.float64]
    descent: Descent


def solve_field(patches: Patches, band: Band, parameters: PoissonParameters) -> SolvedField:
    """Return φ at the corners of the band around these patches, at least one.

    The result may not have converged, which the caller must check: `descent.residual_ratio` then exceeds the tolerance.
    """
    blurred = blurred_planes(patches, band, parameters.blur_ratio * band.width_m)
    weights = corner_weights(patches, band)
    pull = parameters.screening * np.minimum(patches.counts, FULL_POINTS) / FULL_POINTS
    right, diagonal = np.zeros(len(band)), np.zeros(len(band))
    _constrain(band.onward, band.width_m * blurred[:, NORMAL], right, diagonal)
    np.add.at(diagonal, band.corners, pull[:, None] * weights**2)
    field = np.ascontiguousarray(blurred[:, DISTANCE])
    enough = (parameters.tolerance_ratio * band.width_m) ** 2 * len(band)
    rounds, size = _descend((band.onward, band.corners, weights, pull), right, 1.0 / diagonal, enough, field)
    return SolvedField(field, Descent(int(rounds), math.sqrt(size / len(band)) / band.width_m))


def blurred_planes(patches: Patches, band: Band, sigma_m: float) -> NDArray[np.float64]:
    """Return (N, 4): the mean of the patches' normals around each corner, and of its distances to their planes.

    Weights are the patches' points and a Gaussian; patches count if their cell is adjacent to the corner, or one cell
    farther.
    """
    sums = np.zeros((len(band), 5))
    planes = (patches.cells, patches.points_map, patches.normals, patches.counts)
    _blur(planes, band.width_m, sigma_m, (band.table.keys, band.table.rows), sums)
    return np.asarray(sums[:, :4] / sums[:, 4:])


def corner_weights(patches: Patches, band: Band) -> NDArray[np.float64]:
    """Return the trilinear weights (C, 8) of each patch's point on the corners of its cell."""
    least = band.places_map()[band.corners[:, 0]]
    far = (patches.points_map - least) / band.width_m
    near = 1.0 - far
    sides = [np.stack([near[:, axis], far[:, axis]], axis=1) for axis in range(3)]
    return np.asarray(np.einsum("ci,cj,ck->cijk", *sides).reshape(-1, 8))


@njit(cache=True, nogil=True)
def _blur(planes, width_m, sigma_m, table, sums):  # type: ignore[no-untyped-def]
    cells, points, normals, counts = planes
    span = BELOW + ABOVE + 1
    off, bell = np.empty((3, span)), np.empty((3, span))
    for c in range(cells.size):
        index = ((cells[c] >> 42) - BIAS, ((cells[c] >> 21) & MASK) - BIAS, (cells[c] & MASK) - BIAS)
        for axis in range(3):
            for t in range(span):
                off[axis, t] = (index[axis] - BELOW + t + 0.5) * width_m - points[c, axis]
                bell[axis, t] = math.exp(-0.5 * (off[axis, t] / sigma_m) ** 2)
        n0, n1, n2 = normals[c, 0], normals[c, 1], normals[c, 2]
        for i in range(span):
            for j in range(span):
                row = find(table[0], table[1], pack(index[0] - BELOW + i, index[1] - BELOW + j, index[2] - BELOW))
                flat = off[0, i] * n0 + off[1, j] * n1
                wide = counts[c] * bell[0, i] * bell[1, j]
                for k in range(span):
                    w = wide * bell[2, k]
                    at = sums[row + k]
                    at[0] += w * n0
                    at[1] += w * n1
                    at[2] += w * n2
                    at[3] += w * (flat + off[2, k] * n2)
                    at[4] += w


@njit(cache=True, nogil=True)
def _constrain(onward, rise, right, diagonal):  # type: ignore[no-untyped-def]
    """Add the edges' part of the right side and of the diagonal; `rise` (N, 3) is N · w."""
    for a in range(onward.shape[0]):
        for axis in range(3):
            b = onward[a, axis]
            if b < 0:
                continue
            step = 0.5 * (rise[a, axis] + rise[b, axis])
            right[b] += step
            right[a] -= step
            diagonal[a] += 1.0
            diagonal[b] += 1.0


@njit(cache=True, nogil=True)
def _apply(system, x, y):  # type: ignore[no-untyped-def]
    """Compute y = A x: the graph Laplacian of the band's edges plus the patches' term."""
    onward, corners, weights, pull = system
    y[:] = 0.0
    for a in range(onward.shape[0]):
        total = 0.0
        for axis in range(3):
            b = onward[a, axis]
            if b >= 0:
                fall = x[a] - x[b]
                total += fall
                y[b] -= fall
        y[a] += total
    for c in range(corners.shape[0]):
        value = 0.0
        for corner in range(8):
            value += weights[c, corner] * x[corners[c, corner]]
        value *= pull[c]
        for corner in range(8):
            y[corners[c, corner]] += value * weights[c, corner]


@njit(cache=True, nogil=True)
def _descend(system, right, inverse, enough, x):  # type: ignore[no-untyped-def]
    """Run conjugate gradients from `x`, preconditioned by the diagonal, until rᵀD⁻¹r ≤ `enough` or for `MOST_ROUNDS`.

    Return the number of iterations and the final rᵀD⁻¹r, with r = b − A x.
    """
    y = np.empty(x.size)
    _apply(system, x, y)
    r = right - y
    p = r * inverse
    size = (r * p).sum()
    rounds = 0
    while rounds < MOST_ROUNDS and not size <= enough:
        rounds += 1
        _apply(system, p, y)
        bent = (p * y).sum()
        if not bent > 0.0:  # no direction left, or NaN
            break
        step = size / bent
        before, size = size, 0.0
        for i in range(x.size):
            x[i] += step * p[i]
            r[i] -= step * y[i]
            size += r[i] * r[i] * inverse[i]
        for i in range(x.size):
            p[i] = r[i] * inverse[i] + size / before * p[i]
    _apply(system, x, y)
    r = right - y
    return rounds, (r * r * inverse).sum()
