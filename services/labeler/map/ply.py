"""`mesh.ply`: the surface of the whole run, coloured by class, with its terrain features, written tile by tile.

**Conventions.** Binary little-endian PLY 1.0 (Turk, 1994): float x y z in the map frame, uchar red green blue, float
elevation slope roughness (Eq. 1-3); int vertex indices. Vertices of neighbouring tiles are not welded. Vertices with a
class are those of Eq. 4-5, each once; grey vertices only close the triangles at the edge of a tile. A mesh of imported
labels has NaN for features.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stone.geometry.lattice import Keys, keys_of
from stone.labels.class_colours import CLASS_NAME, CLASS_RGB
from stone.labels.voxels import VOXEL_M

FEATURES = "property float elevation\nproperty float slope\nproperty float roughness\n"
HEADER = f"""ply
format binary_little_endian 1.0
comment map frame, metres; classes by colour: {{colours}}
element vertex {{vertices}}
property float x
property float y
property float z
property uchar red
property uchar green
property uchar blue
{FEATURES}element face {{triangles}}
property list uchar int vertex_indices
end_header
"""
VERTEX = np.dtype([("xyz", "<f4", 3), ("rgb", "u1", 3), ("features", "<f4", 3)])
BARE_VERTEX = np.dtype([("xyz", "<f4", 3), ("rgb", "u1", 3)])  # in earlier label sets
FACE = np.dtype([("n", "u1"), ("indices", "<i4", 3)])
UNLABELLED = (128, 128, 128)
VERTEX_RGB = np.array([UNLABELLED, *(CLASS_RGB[c] for c in (1, 2, 3))], np.uint8)
"""The colour of a vertex by its class, 0 to 3."""

Piece = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.int32], NDArray[np.uint8]]
"""Vertices (V, 3), their features (V, 3), triangles (T, 3), the class of each vertex (V,)."""


def write_mesh(path: Path, totals: tuple[int, int], pieces: list[Callable[[], Piece]]) -> None:
    """Write the pieces; each is loaded twice (for vertices and for faces), so memory holds one at a time."""
    with path.open("wb") as file:
        file.write(header_of(*totals))
        for load in pieces:
            vertices, features, _, classes = load()
            rows = np.empty(len(vertices), VERTEX)
            rows["xyz"], rows["rgb"], rows["features"] = vertices, VERTEX_RGB[classes], features
            file.write(rows.tobytes())
        first = 0
        for load in pieces:
            vertices, _, triangles, _ = load()
            faces = np.empty(len(triangles), FACE)
            faces["n"], faces["indices"] = 3, triangles + first
            file.write(faces.tobytes())
            first += len(vertices)


def header_of(vertices: int, triangles: int, has_features: bool = True) -> bytes:
    """Return the header of a mesh with this number of vertices and triangles."""
    colours = ", ".join(f"({r} {g} {b}) {CLASS_NAME[kind]}" for kind, (r, g, b) in CLASS_RGB.items())
    header = HEADER if has_features else HEADER.replace(FEATURES, "")
    return header.format(vertices=vertices, triangles=triangles, colours=colours).encode()


def class_at(vertices: NDArray[np.float32], keys: Keys, classes: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the class of the voxel of each vertex (V, 3); 0 if the voxel is not in the sorted `keys` (K,)."""
    if len(keys) == 0:
        return np.zeros(len(vertices), np.uint8)
    wanted = keys_of(vertices.astype(np.float64), VOXEL_M)
    row = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
    return np.where(keys[row] == wanted, classes[row], 0).astype(np.uint8)
