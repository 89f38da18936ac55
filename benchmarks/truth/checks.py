"""Checks of a simulated run's labels beside the verdict: footprint, evidence, the walker, seams.

**Conventions.** A label grid is placed by the exact pose of its frame, never by the estimated one, so the origin and
the drift of the map do not matter. Counts add over frames; ratios are computed once, for display.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from benchmarks.truth.surface import near_obstacles, read_mesh
from simulator.scenery.movers import WALKER_HEIGHT_M, WALKER_RADIUS_M, walker_ahead
from simulator.sensors.rig import SWEEP_NS
from simulator.truth import SimulationTruth
from simulator.verdict import LabelVerdict, judge_semantics
from stone.geometry.lattice import centres_of, keys_of
from stone.geometry.se3 import SE3, Array
from stone.labels.grid import Grid
from stone.labels.voxels import VOXEL_M
from stone.sensors.selection import SelectionParameters, world_points
from stone.sensors.sequence import Sequence, SweepSource
from stone_base.label_grid import PAPER

FOOTPRINT_BAND_M = 0.15
EVIDENCE_M, THINNED_M = 0.4, 0.05
# A vertex lies within the trim (0.2 m) of a point. A map voxel's centre is within half a diagonal (0.173 m) of its
# vertex, a grid voxel's centre within another of the map's. Surface farther from all points is unmeasured.
REACH_M = 0.55
JUDGED_EVERY, EVIDENCE_EVERY, WALKER_EVERY, SEAM_EVERY = 5, 15, 15, 10
# Below, there is grass and the ground's own voxels; beside an obstacle, its own surface.
WALKER_ABOVE_M, OBSTACLE_CLEAR_M = 0.5, 0.3


@dataclass(frozen=True, eq=False)
class Drive:
    """One simulated run as read by the platform, and its truth."""

    sequence: Sequence
    sweeps: SweepSource
    truth: SimulationTruth

    def world_from_ego(self) -> SE3:
        """Return the exact poses (N,) of the frames."""
        poses = [self.truth.map_from_ego(stamp_ns).wxyz_xyz for stamp_ns in self.sequence.frames.stamps_ns.tolist()]
        return SE3(np.stack(poses))

    def semantics(self, labels: Path, index: int) -> Grid:
        """Return the labels of frame `index` in the label set `labels`."""
        path = labels / "gts" / self.sequence.name / self.sequence.frames.tokens[index] / "labels.npz"
        with np.load(path, allow_pickle=False) as archive:
            grid: Grid = archive["semantics"]
        return grid


def judged(drive: Drive, labels: Path) -> LabelVerdict:
    """Return the verdict of `simulator.verdict` over every `JUDGED_EVERY`-th frame."""
    poses, frames = drive.world_from_ego().as_matrix(), range(0, len(drive.sequence.frames), JUDGED_EVERY)
    counts = [judge_semantics(drive.semantics(labels, frame), drive.truth.judge, poses[frame]) for frame in frames]
    return LabelVerdict(len(counts), *np.sum(counts, axis=0).tolist())


def grid_centres(index: NDArray[np.int64]) -> Array:
    """Return voxel centres (N, 3) in the ego frame."""
    return np.asarray((index + 0.5) * VOXEL_M + np.asarray(PAPER.min_m))


@dataclass(frozen=True)
class FootprintCounts:
    """Occupied voxels under the footprint, and those of them labelled T.

    `in_grid`: the voxel's own centre is under the footprint. `in_map`: so is the centre of the map voxel around it,
    which has surface (a vertex of the mesh). The labels are made in the map: an ego voxel takes the class of the map
    voxel around its centre. That voxel's own centre may be up to half a diagonal (0.17 m) away and so beyond the
    footprint. If it is empty, `stone.labels.grid` may have closed a gap with the class of another.
    """

    in_grid: int
    in_grid_t: int
    in_map: int
    in_map_t: int


def footprint_counts(drive: Drive, labels: Path) -> FootprintCounts:
    """Return the counts over every `JUDGED_EVERY`-th frame, each at its own pose."""
    footprint = drive.sequence.calibration.footprint
    half = np.array([footprint.length_m / 2, footprint.width_m / 2, FOOTPRINT_BAND_M])
    index = np.argwhere(np.ones(PAPER.shape, np.bool_))
    index = index[(np.abs(grid_centres(index)) <= half).all(axis=1)]
    surface = np.unique(keys_of(read_mesh(labels / "mesh.ply").vertices_map, VOXEL_M))
    total = np.zeros(4, np.int64)
    for frame in range(0, len(drive.sequence.frames), JUDGED_EVERY):
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
    """Labelled voxels of the sampled frames.

    Counts of voxels without a measured point within `REACH_M`, and within `EVIDENCE_M`; and without even a ray within
    `EVIDENCE_M`.
    """

    labelled: int
    beyond_reach: int
    without_point: int
    without_ray: int


def evidence_counts(drive: Drive, labels: Path) -> EvidenceCounts:
    """Count the labelled voxels of every `EVIDENCE_EVERY`-th frame beyond `EVIDENCE_M` of any LiDAR measurement.

    First against the points of all sweeps, thinned to `THINNED_M` (the reach is shortened by the half diagonal that
    thinning may move a point, so a pass is a pass). Failures are tried against every ray, from the LiDAR at the sweep's
    stamp to the unthinned point. Points of the robot itself are left out.
    """
    labelled, _ = _labelled_world(drive, labels)
    moved_m = THINNED_M * np.sqrt(3) / 2
    distance, _ = cKDTree(_thinned_points(drive)).query(labelled, distance_upper_bound=REACH_M - moved_m)
    doubtful = labelled[distance > EVIDENCE_M - moved_m]
    beyond = int(np.isinf(distance).sum())
    return EvidenceCounts(len(labelled), beyond, len(doubtful), _without_ray(drive, doubtful))


def invented_counts(drive: Drive, labels: Path, clean: Drive) -> tuple[int, ...]:
    """Return labelled voxels of every `EVIDENCE_EVERY`-th frame, by class, with no point of `clean` within `REACH_M`.

    `clean` is the same drive through the same world without noise.
    """
    labelled, classes = _labelled_world(drive, labels)
    distance, _ = cKDTree(_thinned_points(clean)).query(labelled, distance_upper_bound=REACH_M)
    return tuple(np.bincount(classes[np.isinf(distance)], minlength=4).tolist())


def _labelled_world(drive: Drive, labels: Path) -> tuple[Array, Grid]:
    """Return the world centres (N, 3) of the labelled voxels of every `EVIDENCE_EVERY`-th frame, and their classes
    (N,).
    """
    world_from_ego = drive.world_from_ego()
    centres, classes = [], []
    for frame in range(0, len(world_from_ego), EVIDENCE_EVERY):
        grid = drive.semantics(labels, frame)
        index = np.argwhere(grid > 0)
        centres.append(world_from_ego[frame] @ grid_centres(index))
        classes.append(grid[tuple(index.T)])
    return np.concatenate(centres), np.concatenate(classes)


def points_ego(drive: Drive, frame: int) -> Array:
    """Return the points (N, 3) of a frame's sweep in its ego frame, without the robot's own."""
    calibration = drive.sequence.calibration
    points_lidar, nearest_m = drive.sweeps.sweep(frame).points_lidar, SelectionParameters().min_range_m
    kept = world_points(points_lidar, calibration.ego_from_lidar, calibration.self_boxes_ego, nearest_m)
    return kept.astype(np.float64)


def _thinned_points(drive: Drive) -> Array:
    poses = drive.world_from_ego()
    keys = [np.unique(keys_of(poses[frame] @ points_ego(drive, frame), THINNED_M)) for frame in range(len(poses))]
    return centres_of(np.unique(np.concatenate(keys)), THINNED_M)


def _without_ray(drive: Drive, centres_world: Array) -> int:
    poses = drive.world_from_ego()
    left = centres_world
    for frame in range(len(poses)):
        if len(left) == 0:
            break
        sensor = poses[frame] @ drive.sequence.calibration.ego_from_lidar.translation_m
        left = left[~_is_passed(left, sensor, poses[frame] @ points_ego(drive, frame))]
    return len(left)


@njit(cache=True, nogil=True)
def _is_passed(centres, sensor, points):  # type: ignore[no-untyped-def]
    """Return whether any of the segments sensor → point comes within `EVIDENCE_M` of each centre (N,)."""
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
class WalkerCounts:
    """Labelled voxels in the walker's former space without another surface, by class T, P, N; and the number of such
    voxels.
    """

    voxels: int
    labelled: tuple[int, int, int]


def walker_counts(drive: Drive, labels: Path) -> WalkerCounts:
    """Return the counts over every `WALKER_EVERY`-th frame, in the space that the walker swept through in the whole
    run.

    A voxel is counted when its centre comes within half a voxel of the walker at the middle of a sweep. It must also be
    more than `WALKER_ABOVE_M` above the true ground and farther than `OBSTACLE_CLEAR_M` from every obstacle.
    """
    truth, stamps_ns = drive.truth, drive.sequence.frames.stamps_ns
    walker = walker_ahead(truth.trajectory, truth)
    feet = np.stack([walker.route.at(int(stamp_ns) + SWEEP_NS // 2)[0] for stamp_ns in stamps_ns])
    tree, poses = cKDTree(feet[:, :2]), drive.world_from_ego()
    index = np.argwhere(np.ones(PAPER.shape, np.bool_))
    total = np.zeros(4, np.int64)
    for frame in range(0, len(stamps_ns), WALKER_EVERY):
        world_from_ego = poses[frame]
        plan = (world_from_ego @ grid_centres(index[:: PAPER.shape[2]]))[:, :2]
        near = np.isfinite(tree.query(plan, distance_upper_bound=2.0)[0])
        mine = index.reshape(-1, PAPER.shape[2], 3)[near].reshape(-1, 3)
        centres = world_from_ego @ grid_centres(mine)
        is_walker = np.isfinite(tree.query(centres[:, :2], distance_upper_bound=WALKER_RADIUS_M + VOXEL_M / 2)[0])
        above_m = centres[:, 2] - truth.elevation_m(centres[:, :2])
        is_walker &= (above_m > WALKER_ABOVE_M) & (above_m < WALKER_HEIGHT_M)
        is_walker[is_walker] &= ~near_obstacles(centres[is_walker, :2], truth.obstacles, OBSTACLE_CLEAR_M)
        total += np.bincount(drive.semantics(labels, frame)[tuple(mine[is_walker].T)], minlength=4)
    return WalkerCounts(int(total.sum()), (int(total[1]), int(total[2]), int(total[3])))


@dataclass(frozen=True)
class SeamCounts:
    """Voxels occupied in either of two label sets; in both, with another class; in only one."""

    occupied: int
    class_differs: int
    in_one_only: int


def seam_counts(drive: Drive, labels: Path, others: Path) -> SeamCounts:
    """Return the counts over every `SEAM_EVERY`-th frame."""
    total = np.zeros(3, np.int64)
    for frame in range(0, len(drive.sequence.frames), SEAM_EVERY):
        ours, theirs = drive.semantics(labels, frame), drive.semantics(others, frame)
        both, either = (ours > 0) & (theirs > 0), (ours > 0) | (theirs > 0)
        total += [np.count_nonzero(part) for part in (either, both & (ours != theirs), either & ~both)]
    return SeamCounts(*total.tolist())
