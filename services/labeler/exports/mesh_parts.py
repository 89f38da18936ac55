"""The map's mesh in parts of bounded size, so that no format has to hold it whole."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from services.labeler.exports.ply_file import open_mesh
from services.labeler.map.ply import VERTEX_RGB

MOST_TRIANGLES = 1 << 17


@dataclass(frozen=True, eq=False)
class MeshPart:
    """`vertices_map` (V, 3), each in some triangle, `rgb` (V, 3) of their classes, and `triangles` (T, 3) of them."""

    vertices_map: NDArray[np.float32]
    rgb: NDArray[np.uint8]
    triangles: NDArray[np.uint32]


def mesh_parts(path: Path, most_triangles: int = MOST_TRIANGLES) -> Iterator[MeshPart]:
    """The mesh in the file's order; nothing for an empty one. Raises `DamagedLabelsError`."""
    mesh = open_mesh(path)
    for begin in range(0, len(mesh.faces), most_triangles):
        corners = mesh.faces["indices"][begin : begin + most_triangles]
        rows, triangles = np.unique(corners, return_inverse=True)
        vertices = mesh.vertices[rows]
        yield MeshPart(
            np.ascontiguousarray(vertices["xyz"]),
            VERTEX_RGB[mesh.classes(rows)],
            triangles.reshape(-1, 3).astype(np.uint32),
        )
