"""Terrain features at every vertex of the mesh: elevation, slope, roughness (paper, IV-B, Eq. 1–3).

**Conventions.** Features are columns in the order of `ELEVATION, SLOPE, ROUGHNESS`. The slope uses the signed normal:
an underside has more than π/2, so a canopy does not look like flat ground.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone.surface.mesh import Mesh
from stone.surface.neighbours import cells_of, plane_fits

ELEVATION, SLOPE, ROUGHNESS = 0, 1, 2


@dataclass(frozen=True)
class TerrainParameters:
    """Parameters of roughness. 1e-6 m² (1 mm) is far below LiDAR noise; a noiseless plane would give log 0."""

    neighbours: int = 20
    roughness_floor_m2: float = 1e-6
    cell_m: float = 0.2


def terrain_features(mesh: Mesh, normals: NDArray[np.float64], parameters: TerrainParameters) -> NDArray[np.float64]:
    """Return (V, 3): h = z (Eq. 1), θ = arccos(n·z) (Eq. 2) and the roughness r (Eq. 3).

    The roughness is the log of the mean squared distance of the k nearest vertices to their best-fit plane.

    `normals` are the `vertex_normals` of the untrimmed mesh.
    """
    slope = np.arccos(np.clip(normals[:, 2], -1.0, 1.0))
    return np.stack([mesh.vertices_map[:, 2], slope, roughness(mesh.vertices_map, parameters)], axis=1)


def with_elevation(features: NDArray[np.float64], elevation_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the features (N, 3) with another elevation (N,)."""
    return np.column_stack([elevation_m, features[:, SLOPE], features[:, ROUGHNESS]])


def roughness(vertices_map: NDArray[np.float64], parameters: TerrainParameters) -> NDArray[np.float64]:
    """Return Eq. 3 per vertex (V,), log m²; the floor also applies to vertices with too few neighbours."""
    fits = plane_fits(cells_of(vertices_map, parameters.cell_m), parameters.neighbours)
    mean_square = np.nan_to_num(fits.mean_square_m2, nan=0.0)
    return np.log(np.maximum(mean_square, parameters.roughness_floor_m2))
