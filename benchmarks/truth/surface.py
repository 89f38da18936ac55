"""The errors of the mesh relative to the true ground: slope and roughness at its vertices.

**Conventions.** Errors are taken at ground vertices: within `GROUND_BAND_M` of the true height and at least
`OBJECT_MARGIN_M` in plan from every obstacle (rock, bush, trunk, wall; grass is included). The truth is the true ground
at the same positions: the mesh's vertices moved vertically onto it, with the same triangles and neighbours. So both
have one scale, and relief that the mesh resolves correctly is no error.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from services.labeler.exports.meshes import open_mesh
from simulator.truth import SimulationTruth
from stone.geometry.se3 import SE3, Array, rotate
from stone.surface.mesh import Mesh
from stone.surface.terrain import TerrainParameters

GROUND_BAND_M, OBJECT_MARGIN_M = 0.2, 0.5
ROUGHNESS_EVERY = 4  # vertices


@dataclass(frozen=True, eq=False)
class SurfaceErrors:
    """Absolute errors at ground vertices: slope (n,) degrees; roughness (m,), log m²; the share that faces down."""

    slope_deg: Array
    roughness_log_m2: Array
    upside_down: float


def surface_errors(mesh: Mesh, poses: tuple[SE3, SE3], truth: SimulationTruth) -> SurfaceErrors:
    """Return the errors of the mesh; `poses` are `map_from_ego` and the exact `world_from_ego` (N,).

    Slope is of the area-weighted mean of a vertex' faces, roughness Eq. 3 over its `neighbours` nearest vertices, for
    every `ROUGHNESS_EVERY`-th vertex whose neighbours are all ground. A vertex goes from the map into the world through
    the ego frame of the nearest frame in plan.
    """
    map_from_ego, world_from_ego = poses
    _, nearest = cKDTree(map_from_ego.translation_m[:, :2]).query(mesh.vertices_map[:, :2])
    world_from_map = (world_from_ego @ map_from_ego.inverse())[nearest]
    vertices, normals = world_from_map @ mesh.vertices_map, rotate(world_from_map.wxyz, area_normals(mesh))
    true_vertices = np.column_stack([vertices[:, :2], truth.elevation_m(vertices[:, :2])])
    is_ground = np.abs(vertices[:, 2] - true_vertices[:, 2]) <= GROUND_BAND_M
    is_ground &= ~near_obstacles(vertices[:, :2], truth.obstacles, OBJECT_MARGIN_M)
    is_ground &= np.linalg.norm(normals, axis=1) > 0
    true_normals = area_normals(Mesh(true_vertices, mesh.triangles))
    slopes, true_slopes = (np.arccos(np.clip(n[is_ground, 2], -1.0, 1.0)) for n in (normals, true_normals))
    rough = _roughness_errors(vertices, true_vertices, is_ground)
    return SurfaceErrors(np.rad2deg(np.abs(slopes - true_slopes)), rough, float((normals[is_ground, 2] < 0).mean()))


def _roughness_errors(vertices: Array, true_vertices: Array, is_ground: NDArray[np.bool_]) -> Array:
    chosen = np.flatnonzero(is_ground)[::ROUGHNESS_EVERY]
    _, near = cKDTree(vertices).query(vertices[chosen], k=TerrainParameters().neighbours)
    near = near[is_ground[near].all(axis=1)]
    return np.abs(_roughness(vertices[near]) - _roughness(true_vertices[near]))


def _roughness(near: Array) -> Array:
    """Return Eq. 3 of neighbourhoods (n, k, 3), log m²."""
    off = near - near.mean(axis=1, keepdims=True)
    mean_square = np.linalg.eigvalsh(np.einsum("nki,nkj->nij", off, off) / near.shape[1])[:, 0]
    return np.asarray(np.log(np.maximum(mean_square, TerrainParameters().roughness_floor_m2)))


def read_mesh(path: Path) -> Mesh:
    """Return the mesh written by `services.labeler.map.ply`."""
    mesh = open_mesh(path)
    return Mesh(mesh.vertices["xyz"].astype(np.float64), mesh.faces["indices"].astype(np.int32))


def area_normals(mesh: Mesh) -> Array:
    """Return unit normals (V, 3), faces weighted by area (the labels weight them equally); zero without a face."""
    a, b, c = (mesh.vertices_map[mesh.triangles[:, corner]] for corner in range(3))
    doubled = np.cross(b - a, c - a)
    rows = mesh.triangles.T.ravel()
    sums = [np.bincount(rows, np.tile(doubled[:, axis], 3), len(mesh.vertices_map)) for axis in range(3)]
    normals = np.stack(sums, axis=1)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.asarray(np.divide(normals, length, out=np.zeros_like(normals), where=length > 0))


def near_obstacles(xy: Array, obstacles: NDArray[np.void], margin_m: float) -> NDArray[np.bool_]:
    """Return which points (N, 2) are within `margin_m` of an obstacle's side, or inside it."""
    near = np.zeros(len(xy), np.bool_)
    tree = cKDTree(xy)
    for obstacle in obstacles:
        near[tree.query_ball_point((obstacle["x"], obstacle["y"]), obstacle["radius"] + margin_m)] = True
    return near
