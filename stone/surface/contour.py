"""The surface where a field on the lattice is zero, as triangles: marching cubes (Lorensen & Cline, 1987).

**Conventions.** A corner counts as outside where its value is positive. A vertex lies on the lattice edge that the
surface crosses, where the linear course between the edge's ends is zero: on a line between voxel centres, never on a
voxel border. On a face with two pairs of opposite corners the inside ones are joined, on both sides of the face alike,
so the surface is closed. Triangles are counter-clockwise seen from outside. Cells with a corner off the band are none.
"""

from collections.abc import Iterator

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.geometry.lattice import BIAS, MASK
from stone.surface.band import Band
from stone.surface.mesh import Mesh

CORNERS = 8  # of a cell; bit 2 of a corner's number is its place along x, bit 1 along y, bit 0 along z
EDGES = tuple((base, axis) for axis in range(3) for base in range(CORNERS) if not base & 4 >> axis)


def zero_surface(band: Band, field: NDArray[np.float64]) -> Mesh:
    """The mesh of field (N,) = 0 over the whole cells of the band."""
    cases = np.zeros(len(band), np.uint8)
    _classify(band.onward, field, cases)
    triangles = np.empty((int((TRIANGLES >= 0).sum(axis=(1, 2))[cases].sum()) // 3, 3), np.int32)
    vertices = np.empty((triangles.size, 3))
    count = _triangulate((band.keys, band.onward, band.width_m), field, cases, (vertices, triangles))
    return Mesh(vertices[:count].copy(), triangles)


def _faces() -> Iterator[list[int]]:
    """The corners of each face of a cell, counter-clockwise seen from outside."""
    for axis in range(3):
        bit, u, v = (4 >> (axis + turn) % 3 for turn in range(3))
        for side in (0, bit):
            loop = [side, side | u, side | u | v, side | v]
            yield loop if side else loop[::-1]


def _loops(case: int) -> Iterator[list[int]]:
    """The closed polygons of crossed edges in a cell whose outside corners are the bits of `case`."""
    number = {edge: at for at, edge in enumerate(EDGES)}
    onward: dict[int, int] = {}
    for face in _faces():
        crossed = []
        for a, b in zip(face, face[1:] + face[:1], strict=True):
            if (case >> a ^ case >> b) & 1:
                crossed.append((number[min(a, b), (4, 2, 1).index(a ^ b)], case >> a & 1))
        for at, (edge, leaves_outside) in enumerate(crossed):
            if leaves_outside:
                onward[edge] = crossed[at - 1][0]
    while onward:
        edge, following = onward.popitem()
        loop = [edge]
        while following != edge:
            loop.append(following)
            following = onward.pop(following)
        yield loop


def _table() -> NDArray[np.int8]:
    """Per case (256, most, 3) the edges of its triangles, −1 after the last; polygons are cut into fans."""
    cases = [
        [(loop[0], loop[at], loop[at + 1]) for loop in _loops(case) for at in range(1, len(loop) - 1)]
        for case in range(1 << CORNERS)
    ]
    table = np.full((len(cases), max(map(len, cases)), 3), -1, np.int8)
    for row, triangles in zip(table, cases, strict=True):
        row[: len(triangles)] = np.reshape(triangles, (-1, 3))
    return table


TRIANGLES = _table()
EDGE_BASE, EDGE_AXIS = (np.array(column, np.int8) for column in zip(*EDGES, strict=True))


@njit(inline="always")
def _gather(onward, row, corners):  # type: ignore[no-untyped-def]
    """Fill the rows of the corners of the cell whose least is `row`; whether all are there."""
    corners[0] = row
    for corner in range(1, CORNERS):
        if corner & 4:
            corners[corner] = onward[corners[corner & 3], 0]
        elif corner & 2:
            corners[corner] = onward[corners[corner & 1], 1]
        else:
            corners[corner] = onward[row, 2]
        if corners[corner] < 0:
            return False
    return True


@njit(cache=True, nogil=True)
def _classify(onward, field, cases):  # type: ignore[no-untyped-def]
    """The outside corners of the cell at each corner of the band, as bits; 0 where the cell is not whole."""
    corners = np.empty(CORNERS, np.int64)
    for row in range(field.size):
        if not _gather(onward, row, corners):
            continue
        for corner in range(CORNERS):
            if field[corners[corner]] > 0:
                cases[row] |= np.uint8(1 << corner)


@njit(cache=True, nogil=True)
def _triangulate(lattice, field, cases, out):  # type: ignore[no-untyped-def]
    """Fill vertices and triangles; how many vertices there are."""
    keys, onward, width_m = lattice
    vertices, triangles = out
    vertex_of = np.full((keys.size, 3), -1, np.int32)
    corners = np.empty(CORNERS, np.int64)
    made, filled = 0, 0
    for row in range(keys.size):
        if cases[row] == 0 or cases[row] == 255:
            continue
        _gather(onward, row, corners)
        for triangle in TRIANGLES[cases[row]]:
            if triangle[0] < 0:
                break
            for turn in range(3):
                base, axis = corners[EDGE_BASE[triangle[turn]]], EDGE_AXIS[triangle[turn]]
                if vertex_of[base, axis] < 0:
                    vertex_of[base, axis] = made
                    _place(vertices[made], keys[base], width_m)
                    share = field[base] / (field[base] - field[onward[base, axis]])
                    vertices[made, axis] += share * width_m
                    made += 1
                triangles[filled, turn] = vertex_of[base, axis]
            filled += 1
    return made


@njit(inline="always")
def _place(vertex, key, width_m):  # type: ignore[no-untyped-def]
    vertex[0] = ((key >> 42) - BIAS + 0.5) * width_m
    vertex[1] = (((key >> 21) & MASK) - BIAS + 0.5) * width_m
    vertex[2] = ((key & MASK) - BIAS + 0.5) * width_m
