"""The surface as triangles, and the normal of every vertex (paper, Eq. 2).

**Conventions.** Vertices (V, 3) in metres in the `map` frame; triangles (F, 3) are counter-clockwise seen from
outside, so normals point out of the ground.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

DEGENERATE_M2 = 1e-12
"""Twice the area below which a face has no direction. Corners 1 km from the origin are rounded to 1e-13 m, and a plane
through its lattice's corners is cut into as many slivers as triangles.
"""


@dataclass(frozen=True, eq=False)
class Mesh:
    """`vertices_map` (V, 3) float64 and `triangles` (F, 3) int32."""

    vertices_map: NDArray[np.float64]
    triangles: NDArray[np.int32]

    def where(self, keep: NDArray[np.bool_]) -> "Mesh":
        """Return the mesh of the kept vertices (V,) and of the triangles with three kept vertices."""
        renumbered = np.cumsum(keep, dtype=np.int32) - 1
        a, b, c = self.triangles.T
        whole = keep[a] & keep[b] & keep[c]
        kept = np.compress(keep, self.vertices_map, axis=0)  # five times faster than indexing with a mask
        return Mesh(kept, renumbered[np.compress(whole, self.triangles, axis=0)].reshape(-1, 3))


def vertex_normals(mesh: Mesh) -> NDArray[np.float64]:
    """Return n of Eq. 2: the normalised mean of the incident faces' unit normals (V, 3); zero without a face."""
    normals = np.zeros(mesh.vertices_map.shape)
    _accumulate(mesh.vertices_map, mesh.triangles, normals)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    unit: NDArray[np.float64] = np.divide(normals, length, out=np.zeros_like(normals), where=length > 0)
    return unit


@njit(cache=True, nogil=True)
def _accumulate(vertices, triangles, normals):  # type: ignore[no-untyped-def]
    for f in range(triangles.shape[0]):
        a, b, c = triangles[f, 0], triangles[f, 1], triangles[f, 2]
        ux, uy, uz = (
            vertices[b, 0] - vertices[a, 0],
            vertices[b, 1] - vertices[a, 1],
            vertices[b, 2] - vertices[a, 2],
        )
        vx, vy, vz = (
            vertices[c, 0] - vertices[a, 0],
            vertices[c, 1] - vertices[a, 1],
            vertices[c, 2] - vertices[a, 2],
        )
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        if length < DEGENERATE_M2:
            continue
        for corner in range(3):
            v = triangles[f, corner]
            normals[v, 0] += nx / length
            normals[v, 1] += ny / length
            normals[v, 2] += nz / length
