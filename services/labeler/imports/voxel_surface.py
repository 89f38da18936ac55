"""The surface of a voxel map: the faces of voxels that no other voxel covers, but those that look down.

**Conventions.** A face is two triangles, counter-clockwise from outside. Faces of voxels of one class share their
corners, so a vertex has one class. Voxels are on a lattice of `size_m`, corners at multiples of it.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from services.domain.viewer.formats import TileMesh
from stone.geometry.lattice import Keys, find, indices_of, keys_from_indices, table_of

# East, west, north, south, up; and of each the corners of the face, counter-clockwise seen from outside.
TOWARDS = np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1)], np.int64)
CORNERS = np.array(
    [
        [(1, 0, 0), (1, 1, 0), (1, 1, 1), (1, 0, 1)],
        [(0, 1, 0), (0, 0, 0), (0, 0, 1), (0, 1, 1)],
        [(1, 1, 0), (0, 1, 0), (0, 1, 1), (1, 1, 1)],
        [(0, 0, 0), (1, 0, 0), (1, 0, 1), (0, 0, 1)],
        [(0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)],
    ],
    np.int64,
)
HALVES = np.array([(0, 1, 2), (0, 2, 3)])


def exposed_faces(keys: Keys, classes: NDArray[np.uint8], size_m: float) -> TileMesh:
    """The surface of voxels (K,) of these classes; vertices in metres of the lattice. Nothing gives nothing."""
    voxels, sides = np.nonzero(_is_open(keys))
    corners = (indices_of(keys)[voxels, None, :] + CORNERS[sides]).reshape(-1, 3)
    kinds = classes[voxels].repeat(4)
    _, first, rows = np.unique(_named(corners, kinds), return_index=True, return_inverse=True)
    triangles = rows.reshape(-1, 4)[:, HALVES].reshape(-1, 3)
    return TileMesh(corners[first] * size_m, kinds[first], triangles.astype(np.int32))


def coarser(keys: Keys, classes: NDArray[np.uint8]) -> tuple[Keys, NDArray[np.uint8]]:
    """Voxels of twice the size, each of the highest class in it: the more cautious one."""
    order = np.argsort(keys_from_indices(indices_of(keys) >> 1), kind="stable")
    halved = keys_from_indices(indices_of(keys[order]) >> 1)
    first = np.flatnonzero(np.append(True, np.diff(halved) != 0)[: len(halved)])
    return halved[first], np.maximum.reduceat(classes[order], first) if len(first) else classes


def few_faces(keys: Keys, classes: NDArray[np.uint8], size_m: float, most_triangles: int) -> TileMesh:
    """The surface with at most so many triangles: of larger voxels where there would be more."""
    while 2 * int(_is_open(keys).sum()) > most_triangles:
        keys, classes = coarser(keys, classes)
        size_m *= 2
    return exposed_faces(keys, classes, size_m)


def _is_open(keys: Keys) -> NDArray[np.bool_]:
    """Which faces (K, 5) of the voxels no other covers."""
    table, is_open = table_of(keys), np.zeros((len(keys), len(TOWARDS)), np.bool_)
    _open(keys, (table.keys, table.rows), TOWARDS, is_open)
    return is_open


def _named(corners: NDArray[np.int64], kinds: NDArray[np.uint8]) -> NDArray[np.int64]:
    """A number for each corner and class: 20 bits an axis from the lowest corner on, 2 for the class."""
    low = corners.min(axis=0, initial=1 << 40) if len(corners) else np.zeros(3, np.int64)
    i, j, k = (corners - low).T
    return np.asarray((((i << 20 | j) << 21 | k) << 2) | kinds.astype(np.int64), dtype=np.int64)


@njit(cache=True, nogil=True)
def _open(keys, table, towards, is_open):  # type: ignore[no-untyped-def]
    """A neighbour's key differs by the same number everywhere: no axis carries into the next within the lattice."""
    for voxel in range(keys.size):
        for side in range(towards.shape[0]):
            step = (towards[side, 0] << 42) + (towards[side, 1] << 21) + towards[side, 2]
            is_open[voxel, side] = find(table[0], table[1], keys[voxel] + step) < 0
