"""Counts of movers' remains, and of surfaces lost with them, relative to the same drive without movers.

**Conventions.** Counts are of map voxels with surface within `NEAR_M` in plan of a pose: every label of a frame is the
class of one of them. Two touching voxels may replace each other, since the position of a surface has this uncertainty.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from benchmarks.truth.checks import Drive, points_ego
from benchmarks.truth.surface import read_mesh
from simulator.scenery.movers import Mover
from stone.geometry.lattice import Keys, centres_of, keys_of
from stone.geometry.se3 import Array
from stone.labels.voxels import VOXEL_M

NEAR_M = 24.0
TOUCHING_M = VOXEL_M * 1.75  # a corner's distance is √3
MARGIN_M = 0.3  # around a mover: half a voxel, the drift of the map, a vehicle's path in half a sweep
SEEN_M = VOXEL_M


@dataclass(frozen=True)
class MoverCounts:
    """Counts of voxels with surface.

    - `voxels`: all of them.
    - `left`: remains of movers that drove or walked on, absent from the drive without movers.
    - `parked`: surface of parked vehicles.
    - `standing`: surface of the drive without movers that this drive's LiDAR hit too.
    - `lost`: the part of `standing` without surface in this drive's labels.
    """

    voxels: int
    left: int
    parked: int
    standing: int
    lost: int


def mover_counts(busy: tuple[Drive, Path], clear: tuple[Drive, Path], movers: Sequence[Mover]) -> MoverCounts:
    """Return the counts of a drive and its labels, relative to the same drive without the movers."""
    drive, labels = busy
    surface, expected = _surface(drive, labels), _surface(*clear)
    is_new, found_world = ~_touches(surface, expected), _in_world(drive, surface)
    moments_ns = drive.sequence.frames.stamps_ns + _half_sweep_ns(drive)
    is_left, is_parked = np.zeros(len(surface), np.bool_), np.zeros(len(surface), np.bool_)
    for mover in movers:
        for stamp_ns in moments_ns.tolist():
            is_there = mover.is_inside(found_world, stamp_ns, MARGIN_M)
            (is_parked if mover.route.is_standing(stamp_ns) else is_left)[is_there] = True
    lost = expected[~_touches(expected, surface)]
    standing = _standing_points(drive, movers, moments_ns)
    is_seen = np.isfinite(cKDTree(standing).query(expected, distance_upper_bound=SEEN_M)[0])
    is_lost = np.isfinite(cKDTree(standing).query(lost, distance_upper_bound=SEEN_M)[0])
    left, parked = int((is_new & is_left & ~is_parked).sum()), int((is_new & is_parked).sum())
    return MoverCounts(len(surface), left, parked, int(is_seen.sum()), int(is_lost.sum()))


def _surface(drive: Drive, labels: Path) -> Array:
    """Return the centres (N, 3) of the voxels near the track with surface."""
    centres = centres_of(np.unique(keys_of(read_mesh(labels / "mesh.ply").vertices_map, VOXEL_M)), VOXEL_M)
    track = cKDTree(drive.sequence.frames.map_from_ego.translation_m[:, :2])
    return np.asarray(centres[np.isfinite(track.query(centres[:, :2], distance_upper_bound=NEAR_M)[0])])


def _touches(voxels: Array, others: Array) -> NDArray[np.bool_]:
    """Return which of the voxels (N, 3) equal or touch one of the others (M, 3)."""
    return np.asarray(np.isfinite(cKDTree(others).query(voxels, distance_upper_bound=TOUCHING_M)[0]))


def _half_sweep_ns(drive: Drive) -> int:
    """Return half a sweep: a sweep takes 0.1 s, or the time to the next one if that is less."""
    return int(min(np.median(np.diff(drive.sequence.frames.stamps_ns)), 100_000_000)) // 2


def _standing_points(drive: Drive, movers: Sequence[Mover], moments_ns: NDArray[np.int64]) -> Array:
    """Return the map positions (M, 3) of LiDAR hits outside all movers, thinned."""
    kept, world_from_ego = list[Keys](), drive.world_from_ego()
    for frame, stamp_ns in enumerate(moments_ns.tolist()):
        seen = points_ego(drive, frame)
        for mover in movers:
            seen = seen[~mover.is_inside(world_from_ego[frame] @ seen, stamp_ns, MARGIN_M)]
        kept.append(np.unique(keys_of(drive.sequence.frames.map_from_ego[frame] @ seen, VOXEL_M / 2)))
    return centres_of(np.unique(np.concatenate(kept)), VOXEL_M / 2)


def _in_world(drive: Drive, points_map: Array) -> Array:
    """Return points (N, 3) of the map in the world, by the nearest frame in plan."""
    map_from_ego = drive.sequence.frames.map_from_ego
    _, nearest = cKDTree(map_from_ego.translation_m[:, :2]).query(points_map[:, :2])
    return np.asarray((drive.world_from_ego() @ map_from_ego.inverse())[nearest] @ points_map)
