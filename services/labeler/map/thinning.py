"""A surface with fewer triangles: vertices that share a cell become their mean (Rossignac and Borrel, 1993).

**Conventions.** The cell grows by √2 until there are few enough triangles. A cell has the class that most of its
vertices have, class 0 (in no voxel) only where all have it. Triangles keep the side they show. Equal inputs give equal
outputs.
"""

import numpy as np
from numpy.typing import NDArray

from services.domain.viewer.formats import TileMesh
from stone.geometry.corners import corners_of

FIRST_CELL_M = 0.25
GROWTH = 2.0**0.5
CLASSES = 4
MOST_PACKED = 2**21  # numbers of which three fit one of 64 bits


def thinned(mesh: TileMesh, most_triangles: int) -> TileMesh:
    """At most so many triangles (> 0); the mesh as it is where it has no more already."""
    found, cell_m = mesh, FIRST_CELL_M
    while len(found.triangles) > most_triangles:
        found = _clustered(mesh, cell_m)
        cell_m *= GROWTH
    return found


def _clustered(mesh: TileMesh, cell_m: float) -> TileMesh:
    """One vertex for each cell of this size that is still a corner of a triangle."""
    vertices = mesh.vertices_m.astype(np.float64)
    rows = _cells(np.floor((vertices - corners_of(vertices)[0]) / cell_m).astype(np.int64))
    corners = rows[mesh.triangles]
    a, b, c = corners.T
    is_flat = (a == b) | (b == c) | (c == a)
    used, renamed = np.unique(_each_once(corners[~is_flat]), return_inverse=True)
    counts = np.bincount(rows)
    means = np.stack([np.bincount(rows, vertices[:, axis]) / counts for axis in range(3)], axis=1)
    return TileMesh(means[used], _most_frequent(rows, mesh.classes)[used], renamed.reshape(-1, 3).astype(np.int32))


def _cells(indices: NDArray[np.int64]) -> NDArray[np.int64]:
    """A number from 0 on for the cell of each vertex."""
    sides = corners_of(indices)[1] + 1
    keys = (indices[:, 0] * sides[1] + indices[:, 1]) * sides[2] + indices[:, 2]
    return np.unique(keys, return_inverse=True)[1].reshape(-1)


def _each_once(corners: NDArray[np.int64]) -> NDArray[np.int64]:
    """The triangles without repeats, each turned so that its smallest corner comes first, sorted."""
    first = corners.argmin(axis=1)
    turned = np.take_along_axis(corners, (first[:, None] + np.arange(3)) % 3, axis=1)
    side = int(corners.max(initial=0)) + 1
    if side > MOST_PACKED:
        return np.unique(turned, axis=0)
    keys = np.sort((turned[:, 0] * side + turned[:, 1]) * side + turned[:, 2])  # a tenth of the time of sorting rows
    keys = keys[np.append(True, keys[1:] != keys[:-1])[: len(keys)]]
    return np.stack([keys // side**2, keys // side % side, keys % side], axis=1)


def _most_frequent(rows: NDArray[np.int64], classes: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Of each cell the class 1 to 3 that occurs most often in it, of two the lower; 0 where none does."""
    votes = np.stack([np.bincount(rows, classes == kind) for kind in range(CLASSES)], axis=1)
    votes[:, 0] = 0.5
    return np.asarray(votes.argmax(axis=1), dtype=np.uint8)
