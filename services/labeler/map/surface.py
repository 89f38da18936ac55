"""Stage 2, per tile: from the fused points to the surface and its features in every voxel.

merge → vote on moving objects → patches with normals → screened Poisson → trim → terrain (Eq. 1–3)
      → voxel features (Eq. 4–5) → T.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from services.labeler.map.octree import octree_surface
from services.labeler.parameters import LabelParameters
from services.labeler.run import LabelRun, Step, Tile, in_core, neighbourhood, silent
from services.labeler.scratch import Arrays, images_near, load_observed, load_points, packed, save, surface_path
from stone.geometry.corners import corners_of
from stone.geometry.lattice import centres_of
from stone.geometry.se3 import SE3
from stone.labels.footprint import Passes, passed_through, passes
from stone.labels.ground_shape import ground_shape
from stone.labels.observed_voxels import Observed
from stone.labels.profiles import VoxelTerrain, terrain_of
from stone.labels.voxels import VOXEL_M, VoxelFeatures, height_above_local_ground, looks_of, voxel_features
from stone.sensors.ego_path import datum_m, ego_path
from stone.surface.contour import band_of, zero_surface
from stone.surface.dynamic import MotionVotes, carried_along, fewest_misses, is_moving
from stone.surface.mesh import Mesh, vertex_normals
from stone.surface.neighbours import is_near
from stone.surface.patches import patches_of
from stone.surface.pointmap import PointMap, merge
from stone.surface.screened_poisson import NOT_SOLVED, Descent, solve_field
from stone.surface.terrain import ELEVATION, terrain_features, with_elevation

_Surface = tuple[Mesh, NDArray[np.float64]]
FEWEST_POINTS = 100
STEPS = 4  # merged, voted, reconstructed, described


@dataclass(frozen=True, eq=False)
class TileSummary:
    """Summary of a tile, before its voxels have classes.

    `driven` are the n voxels driven over, at the metres `passes` of the track. `descent` is the solver's result, with
    no rounds if it had nothing to solve.
    """

    tile: Tile
    driven: VoxelTerrain
    passes: Passes
    voxels: int
    points: int
    moving: int
    vertices: int
    triangles: int
    descent: Descent = NOT_SOLVED


def surface(run: LabelRun, tile: Tile, step: Step = silent) -> TileSummary:
    """Reconstruct one tile, save its voxels, mesh and observed bricks in scratch, return its sums."""
    step(0, STEPS)
    low, high = _cube(run.parameters, tile)
    points = merge([part for near in neighbourhood(tile) for part in load_points(run, near, low, high)])
    step(1, STEPS)
    path = ego_path(run.sequence, tile.map)
    moving = _moving(run, tile, points) | _passed_through(run, path, points)
    points = points.where(~moving).where_seen(run.parameters.surface.min_frames)
    step(2, STEPS)
    (mesh, normals), descent = _mesh(run.parameters, points, low)
    step(3, STEPS)
    of_vertices, datum = terrain_features(mesh, normals, run.parameters.terrain), datum_m(run.sequence, tile.map)
    terrain = _terrain(run, voxel_features(mesh.vertices_map, of_vertices), points, datum)
    terrain = terrain.where(in_core(centres_of(terrain.keys, VOXEL_M), tile, run.parameters.core_m))
    passes = _passes(run, tile, path, terrain)
    kept, of_kept = _core_mesh(mesh, of_vertices - (datum, 0.0, 0.0), tile, run.parameters.core_m)
    observed = load_observed(run, tile)
    _leave(run, tile, (terrain, passes.is_driven), (kept, of_kept, observed))
    step(STEPS, STEPS)
    inside = int(in_core(points.centroids_map(), tile, run.parameters.core_m).sum())
    counts = (len(terrain), inside, int(moving.sum()), len(kept.vertices_map), len(kept.triangles))
    return TileSummary(tile, terrain.where(passes.is_driven), passes.where(passes.is_driven), *counts, descent)


def _cube(parameters: LabelParameters, tile: Tile) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the tile's cube in plan [low, high) (2,), half a cell off the voxel lattice: corners are voxel centres."""
    low = tile.place.astype(np.float64) * parameters.core_m - parameters.tiling.halo_m + parameters.surface.width_m / 2
    return low, low + parameters.tiling.cube_cells * parameters.surface.width_m


def _moving(run: LabelRun, tile: Tile, points: PointMap) -> NDArray[np.bool_]:
    """Vote on the points of this tile with every range image taken near enough to see them."""
    if len(points) == 0:
        return np.zeros(0, np.bool_)
    centroids = points.centroids_map()
    motion = MotionVotes(centroids, run.parameters.dynamic)
    for images in images_near(run, tile.map, *corners_of(centroids)):
        motion.add(images)
    votes = motion.counts()
    fewest = fewest_misses(run.period_s * run.every(run.parameters.dynamic.every_frame))
    return carried_along(centroids, points.frames_seen(), votes, is_moving(votes, fewest))


def _passed_through(run: LabelRun, path: tuple[SE3, ...], points: PointMap) -> NDArray[np.bool_]:
    """Return the points in the path of the robot's body, left by objects that stood there before or after."""
    heights_m = (run.parameters.body_clearance_m, float(run.sensor_ego[2]))
    return passed_through(points.keys, points.voxel_m, path, run.sequence.calibration.footprint, heights_m)


def _mesh(parameters: LabelParameters, points: PointMap, low: NDArray[np.float64]) -> tuple[_Surface, Descent]:
    """Return the trimmed mesh and its vertex normals, empty with too few points, and the solver's result."""
    surface, centroids = parameters.surface, points.centroids_map()
    patches, is_in_patch = patches_of(centroids, points.views_map(), surface.width_m, surface.normal_neighbours)
    if is_in_patch.sum() < FEWEST_POINTS:
        return (Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32)), np.zeros((0, 3))), NOT_SOLVED
    if surface.solver == "octree":
        cube = (parameters.tiling.cube_cells, surface.width_m)
        whole, descent = octree_surface(centroids, points.views_map(), low, cube), NOT_SOLVED
    else:
        band = band_of(patches.cells, surface.width_m)
        solved = solve_field(patches, band, surface.poisson)
        whole, descent = zero_surface(band, solved.values), solved.descent
    keep = is_near(whole.vertices_map, centroids[is_in_patch], surface.trim_m)
    return (whole.where(keep), vertex_normals(whole)[keep]), descent


def _terrain(run: LabelRun, features: VoxelFeatures, points: PointMap, datum: float) -> VoxelTerrain:
    """Return the terrain of the voxels that the mesh crosses, for all profiles; elevations are above `datum` metres."""
    parameters, vehicle = run.parameters, run.sequence.calibration.vehicle
    voxels = replace(features, features=with_elevation(features.features, features.features[:, ELEVATION] - datum))
    height_m = height_above_local_ground(voxels, parameters.local_ground_radius_m)
    shape = ground_shape(voxels, np.deg2rad(vehicle.max_slope_deg), parameters.body_clearance_m)
    return terrain_of(voxels, height_m, shape, looks_of(voxels.keys, points.keys, points.frames_seen()))


def _passes(run: LabelRun, tile: Tile, path: tuple[SE3, ...], terrain: VoxelTerrain) -> Passes:
    """Return when the robot drove over the voxels; the tracks of earlier maps come before this map's track."""
    footprint, band_m = run.sequence.calibration.footprint, run.parameters.footprint_band_m
    return passes(terrain.keys, path, footprint, band_m, float(run.way_starts_m[tile.map]))


def _core_mesh(mesh: Mesh, terrain: NDArray[np.float64], tile: Tile, core_m: float) -> tuple[Mesh, NDArray[np.float64]]:
    """Return the triangles whose centroid is in the core, with their vertices and all others in the core.

    Adjacent tiles then leave neither gaps nor duplicates. Also returns the features (V, 3) of the vertices.
    """
    plan, (a, b, c) = np.ascontiguousarray(mesh.vertices_map[:, :2]), mesh.triangles.T
    mine = mesh.triangles[in_core((plan[a] + plan[b] + plan[c]) / 3, tile, core_m)]
    used = in_core(plan, tile, core_m)
    used[mine] = True
    return Mesh(mesh.vertices_map, mine).where(used), np.compress(used, terrain, axis=0)


def _leave(
    run: LabelRun,
    tile: Tile,
    voxels: tuple[VoxelTerrain, NDArray[np.bool_]],
    rest: tuple[Mesh, NDArray[np.float64], Observed],
) -> None:
    (terrain, is_driven), (mesh, of_vertices, observed) = voxels, rest
    mesh_arrays: Arrays = {
        "vertices": mesh.vertices_map.astype(np.float32),
        "vertex_features": of_vertices.astype(np.float32),
        "triangles": mesh.triangles,
    }
    arrays: Arrays = {
        "keys": terrain.keys,
        "terrain": terrain.columns,
        "is_driven": is_driven,
        "mesh": packed(mesh_arrays),
        "bricks": observed.keys,
        "words": observed.words,
        "since": observed.since,
    }
    save(surface_path(run, tile), arrays)
