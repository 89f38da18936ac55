"""What labels of a simulated run are held against, beside the verdict: slope, footprint, evidence, seams.

**Conventions.** A label grid is placed by the exact pose of its frame, never by the estimated one, so the origin and
the drift of the map do not matter. Counts add over frames; ratios are read once, where they are shown.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from services.labeler.ply import FACE, VERTEX
from simulator.truth import Truth
from stone.grid import GRID_MIN_M, GRID_SHAPE, Grid
from stone.lattice import centres_of, keys_of
from stone.mesh import Mesh
from stone.se3 import SE3, Array, rotate
from stone.selection import SelectionParameters, world_points
from stone.sequence import Sequence, SweepSource
from stone.voxels import VOXEL_M

GROUND_BAND_M, OBJECT_MARGIN_M = 0.2, 0.5
FOOTPRINT_BAND_M = 0.15
EVIDENCE_M, THINNED_M = 0.4, 0.05
EVIDENCE_EVERY, SEAM_EVERY = 15, 10


@dataclass(frozen=True, eq=False)
class Drive:
    """One simulated run as the platform read it, and the truth about it."""

    sequence: Sequence
    sweeps: SweepSource
    truth: Truth

    def world_from_ego(self) -> SE3:
        """The exact poses (N,) of the frames."""
        poses = [self.truth.map_from_ego(stamp_ns).wxyz_xyz for stamp_ns in self.sequence.frames.stamps_ns.tolist()]
        return SE3(np.stack(poses))

    def semantics(self, labels: Path, index: int) -> Grid:
        """The labels of frame `index` in the label set `labels`."""
        path = labels / "gts" / self.sequence.name / self.sequence.frames.tokens[index] / "labels.npz"
        with np.load(path, allow_pickle=False) as archive:
            grid: Grid = archive["semantics"]
        return grid


def grid_centres(index: NDArray[np.int64]) -> Array:
    """Voxel centres (N, 3) in the ego frame."""
    return np.asarray((index + 0.5) * VOXEL_M + np.asarray(GRID_MIN_M))


def slope_errors_deg(drive: Drive, mesh_path: Path) -> tuple[Array, Array]:
    """|slope of the mesh − slope of the truth| at the vertices that are ground, against two truths.

    The first is the true ground seen through the same triangles, so at the mesh's own scale; the second the true ground
    smoothed over 0.4 m, the robot's scale, where relief that the mesh rightly resolves counts as error.

    Ground: within `GROUND_BAND_M` of the true height and at least `OBJECT_MARGIN_M` in plan from every obstacle (rock,
    bush, trunk, wall; grass stays in). The slope of a vertex is that of the area-weighted mean of its faces' normals.
    A vertex goes from the map into the world through the ego frame of the nearest frame in plan.
    """
    mesh = read_mesh(mesh_path)
    map_from_ego, world_from_ego = drive.sequence.frames.map_from_ego, drive.world_from_ego()
    _, nearest = cKDTree(map_from_ego.translation_m[:, :2]).query(mesh.vertices_map[:, :2])
    world_from_map = (world_from_ego @ map_from_ego.inverse())[nearest]
    vertices, normals = world_from_map @ mesh.vertices_map, rotate(world_from_map.wxyz, area_normals(mesh))
    xy = vertices[:, :2]
    is_ground = np.abs(vertices[:, 2] - drive.truth.elevation_m(xy)) <= GROUND_BAND_M
    is_ground &= ~_near_objects(xy, drive.truth.obstacles) & (np.linalg.norm(normals, axis=1) > 0)
    slope_rad = np.arccos(np.clip(normals[is_ground, 2], -1.0, 1.0))
    true_mesh = Mesh(np.column_stack([xy, drive.truth.elevation_m(xy)]), mesh.triangles)
    true_rad = np.arccos(np.clip(area_normals(true_mesh)[is_ground, 2], -1.0, 1.0))
    smooth_rad = drive.truth.slope_rad(xy[is_ground])
    return np.rad2deg(np.abs(slope_rad - true_rad)), np.rad2deg(np.abs(slope_rad - smooth_rad))


def read_mesh(path: Path) -> Mesh:
    """The mesh that `services.labeler.ply` wrote."""
    content = path.read_bytes()
    head, mark = content.partition(b"end_header\n")[:2]
    counts = [int(line.split()[2]) for line in head.decode().splitlines() if line.startswith("element")]
    begin = len(head) + len(mark)
    vertices = np.frombuffer(content, VERTEX, counts[0], begin)["xyz"]
    faces = np.frombuffer(content, FACE, counts[1], begin + counts[0] * VERTEX.itemsize)["indices"]
    return Mesh(vertices.astype(np.float64), faces.astype(np.int32))


def area_normals(mesh: Mesh) -> Array:
    """Unit normals (V, 3), faces weighted by their area (the labels weight them equally); zero without a face."""
    a, b, c = (mesh.vertices_map[mesh.triangles[:, corner]] for corner in range(3))
    doubled = np.cross(b - a, c - a)
    rows = mesh.triangles.T.ravel()
    sums = [np.bincount(rows, np.tile(doubled[:, axis], 3), len(mesh.vertices_map)) for axis in range(3)]
    normals = np.stack(sums, axis=1)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.asarray(np.divide(normals, length, out=np.zeros_like(normals), where=length > 0))


def _near_objects(xy: Array, obstacles: NDArray[np.void]) -> NDArray[np.bool_]:
    near = np.zeros(len(xy), np.bool_)
    tree = cKDTree(xy)
    for obstacle in obstacles:
        near[tree.query_ball_point((obstacle["x"], obstacle["y"]), obstacle["radius"] + OBJECT_MARGIN_M)] = True
    return near


@dataclass(frozen=True)
class FootprintCounts:
    """Occupied voxels under the footprint, and those of them labelled T.

    `in_grid`: the voxel's own centre is under the footprint. `in_map`: so is the centre of the map voxel around it,
    and that one holds surface (a vertex of the mesh). The labels are made in the map: an ego voxel takes the class of
    the map voxel that holds its centre, whose own centre may lie up to half a diagonal (0.17 m) away and so beyond the
    footprint; and where that one is empty, `stone.grid` may have closed a gap with the class of another.
    """

    in_grid: int
    in_grid_t: int
    in_map: int
    in_map_t: int


def footprint_counts(drive: Drive, labels: Path) -> FootprintCounts:
    """Over all frames, each at its own pose."""
    footprint = drive.sequence.calibration.footprint
    half = np.array([footprint.length_m / 2, footprint.width_m / 2, FOOTPRINT_BAND_M])
    index = np.argwhere(np.ones(GRID_SHAPE, np.bool_))
    index = index[(np.abs(grid_centres(index)) <= half).all(axis=1)]
    surface = np.unique(keys_of(read_mesh(labels / "mesh.ply").vertices_map, VOXEL_M))
    total = np.zeros(4, np.int64)
    for frame in range(len(drive.sequence.frames)):
        classes = drive.semantics(labels, frame)[tuple(index.T)]
        map_from_ego = drive.sequence.frames.map_from_ego[frame]
        keys = keys_of(map_from_ego @ grid_centres(index), VOXEL_M)
        is_under = (np.abs(map_from_ego.inverse() @ centres_of(keys, VOXEL_M)) <= half).all(axis=1)
        is_under &= np.isin(keys, surface)
        occupied, driven = classes > 0, classes == 1
        total += [np.count_nonzero(part) for part in (occupied, driven, occupied & is_under, driven & is_under)]
    return FootprintCounts(*total.tolist())


@dataclass(frozen=True)
class EvidenceCounts:
    """Labelled voxels of the sampled frames, those without a measured point near, those without even a ray near."""

    labelled: int
    without_point: int
    without_ray: int


def evidence_counts(drive: Drive, labels: Path) -> EvidenceCounts:
    """Is every labelled voxel of every `EVIDENCE_EVERY`-th frame within `EVIDENCE_M` of something the LiDAR measured?

    First against the points of all sweeps, thinned to `THINNED_M` (the reach is shortened by the half diagonal that
    thinning may move a point, so a pass is a pass); what fails is tried against every ray, from the LiDAR at the
    sweep's stamp to the unthinned point. Points of the robot itself are left out.
    """
    world_from_ego = drive.world_from_ego()
    centres = []
    for frame in range(0, len(world_from_ego), EVIDENCE_EVERY):
        index = np.argwhere(drive.semantics(labels, frame) > 0)
        centres.append(world_from_ego[frame] @ grid_centres(index))
    labelled = np.concatenate(centres)
    reach_m = EVIDENCE_M - THINNED_M * np.sqrt(3) / 2
    distance, _ = cKDTree(_thinned_points(drive)).query(labelled, distance_upper_bound=reach_m)
    doubtful = labelled[np.isinf(distance)]
    return EvidenceCounts(len(labelled), len(doubtful), _without_ray(drive, doubtful))


def _points_world(drive: Drive, frame: int, world_from_ego: SE3) -> Array:
    calibration = drive.sequence.calibration
    points_lidar, nearest_m = drive.sweeps.sweep(frame).points_lidar, SelectionParameters().min_range_m
    points_ego = world_points(points_lidar, calibration.ego_from_lidar, calibration.self_boxes_ego, nearest_m)
    return world_from_ego @ points_ego.astype(np.float64)


def _thinned_points(drive: Drive) -> Array:
    poses = drive.world_from_ego()
    keys = [np.unique(keys_of(_points_world(drive, frame, poses[frame]), THINNED_M)) for frame in range(len(poses))]
    return centres_of(np.unique(np.concatenate(keys)), THINNED_M)


def _without_ray(drive: Drive, centres_world: Array) -> int:
    poses = drive.world_from_ego()
    left = centres_world
    for frame in range(len(poses)):
        if len(left) == 0:
            break
        sensor = poses[frame] @ drive.sequence.calibration.ego_from_lidar.translation_m
        left = left[~_is_passed(left, sensor, _points_world(drive, frame, poses[frame]))]
    return len(left)


@njit(cache=True, nogil=True)
def _is_passed(centres, sensor, points):  # type: ignore[no-untyped-def]
    """Does any of the segments sensor → point come within `EVIDENCE_M` of each centre (N,)?"""
    passed = np.zeros(len(centres), np.bool_)
    for c in range(len(centres)):
        x, y, z = centres[c, 0] - sensor[0], centres[c, 1] - sensor[1], centres[c, 2] - sensor[2]
        for p in range(len(points)):
            u, v, w = points[p, 0] - sensor[0], points[p, 1] - sensor[1], points[p, 2] - sensor[2]
            t = min(max((x * u + y * v + z * w) / (u * u + v * v + w * w), 0.0), 1.0)
            if (x - t * u) ** 2 + (y - t * v) ** 2 + (z - t * w) ** 2 <= EVIDENCE_M**2:
                passed[c] = True
                break
    return passed


@dataclass(frozen=True)
class SeamCounts:
    """Voxels occupied in either of two label sets; in both, with another class; in one of them only."""

    occupied: int
    class_differs: int
    in_one_only: int


def seam_counts(drive: Drive, labels: Path, others: Path) -> SeamCounts:
    """Over every `SEAM_EVERY`-th frame."""
    total = np.zeros(3, np.int64)
    for frame in range(0, len(drive.sequence.frames), SEAM_EVERY):
        ours, theirs = drive.semantics(labels, frame), drive.semantics(others, frame)
        both, either = (ours > 0) & (theirs > 0), (ours > 0) | (theirs > 0)
        total += [np.count_nonzero(part) for part in (either, both & (ours != theirs), either & ~both)]
    return SeamCounts(*total.tolist())
