"""Figures of labels without a ground truth: surfaces facing down, the position of T, known flat ground and walls.

**Conventions.** A share is None if its base is empty. Heights are above the ego plane of the nearest pose of the track.
Ground is the part of the mesh that is nearly level, either side up, with no mesh below it, within `SEEN_M` of the track
and at a similar height.
"""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from matplotlib.path import Path as Outline
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from benchmarks.real.description import Described
from benchmarks.real.labelled_map import Figures, LabelledMap, read_map, share
from benchmarks.truth.surface import area_normals, read_mesh
from stone.geometry.lattice import keys_of
from stone.geometry.se3 import SE3, Array
from stone.labels.footprint import densified
from stone.labels.grid import Grid
from stone.labels.track_coverage import STEP_M, covered_places
from stone.labels.traversability import NON_TRAVERSABLE, TRAVERSABLE
from stone.labels.voxels import VOXEL_M
from stone.sensors.ego_path import ego_path
from stone.sensors.sequence import Sequence

LEVEL_COSINE = np.cos(np.deg2rad(30.0))
SEEN_M, GROUND_BAND_M, BELOW_M = 25.0, 1.0, 0.15
WALL_M, WALL_FROM_M, WALL_TO_M = 0.3, 0.5, 2.5
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class WrittenLabels:
    """A written label set, and its sequence."""

    described: Described
    sequence: Sequence
    folder: Path

    @cached_property
    def voxels(self) -> LabelledMap:
        return read_map(self.folder)

    @cached_property
    def way(self) -> SE3:
        """Return poses (W,) at most `STEP_M` apart along the track of the first map."""
        stretches = [densified(stretch, STEP_M, STEP_M) for stretch in ego_path(self.sequence, 0)]
        return SE3(np.concatenate([stretch.wxyz_xyz for stretch in stretches]))

    def grid(self, frame: int) -> Grid:
        """Return the classes of the voxels around frame `frame`."""
        path = self.folder / "gts" / self.sequence.name / self.sequence.frames.tokens[frame] / "labels.npz"
        with np.load(path, allow_pickle=False) as archive:
            classes: Grid = archive["semantics"]
        return classes

    def above_track(self, points_map: Array) -> tuple[Array, Array]:
        """Return the distance in plan (N,) to the track's nearest pose, and the height (N,) above its ego plane."""
        away_m, nearest = cKDTree(self.way.translation_m[:, :2]).query(points_map[:, :2])
        return away_m, (self.way[nearest].inverse() @ points_map)[:, 2]

    def is_flat(self, points_map: Array) -> Mask:
        """Return which points (N, 3) are, in plan, in an area that the description declares flat."""
        description = self.described.description
        inside = self.above_track(points_map)[0] < description.flat_beside_track_m
        for polygon in description.flat_m:
            inside |= Outline(np.asarray(polygon)).contains_points(points_map[:, :2])
        return np.asarray(inside)


def measured(labels: WrittenLabels) -> Figures:
    """Return every figure of one label set that needs no other label set and no classes."""
    return {
        **facing_down(labels),
        "covered": t_coverage(labels),
        "flat_n": flat_non_traversable(labels),
        "wall_n": wall_non_traversable(labels),
    }


def facing_down(labels: WrittenLabels) -> Figures:
    """Return the share of ground vertices that face down, among all near the track and in areas declared flat."""
    mesh = read_mesh(labels.folder / "mesh.ply")
    vertices, up = mesh.vertices_map, area_normals(mesh)[:, 2]
    away_m, height_m = labels.above_track(vertices)
    is_ground = (np.abs(up) >= LEVEL_COSINE) & (away_m < SEEN_M) & (np.abs(height_m) < GROUND_BAND_M)
    is_ground &= lowest(vertices)
    flat = is_ground & labels.is_flat(vertices)
    return {"ground_down": share(up[is_ground] < 0), "flat_down": share(up[flat] < 0)}


def lowest(points_map: Array) -> Mask:
    """Return which points (N, 3) have no other more than `BELOW_M` below them in their column of `VOXEL_M`."""
    flat = points_map * (1.0, 1.0, 0.0)
    _, column = np.unique(keys_of(flat, VOXEL_M), return_inverse=True)
    floor_m = np.full(int(column.max(initial=-1)) + 1, np.inf)
    np.minimum.at(floor_m, column, points_map[:, 2])
    return np.asarray(points_map[:, 2] - floor_m[column] <= BELOW_M)


def t_coverage(labels: WrittenLabels) -> float | None:
    """Return the share of places under the footprint, along the track, with T in the voxel, or above or below it."""
    driven = labels.voxels.keys[labels.voxels.classes == TRAVERSABLE]
    return share(covered_places(driven, labels.way, labels.sequence.calibration.footprint)[0].ravel())


def flat_non_traversable(labels: WrittenLabels) -> float | None:
    """Return the share of N in the lowest voxels of areas declared flat, without driven ground."""
    voxels = labels.voxels
    where = labels.is_flat(voxels.centres_map) & lowest(voxels.centres_map) & (voxels.classes != TRAVERSABLE)
    return share(voxels.classes[where] == NON_TRAVERSABLE)


def wall_non_traversable(labels: WrittenLabels) -> float | None:
    """Return the share of N in the voxels of the known walls, between two heights."""
    centres, is_wall = labels.voxels.centres_map, np.zeros(len(labels.voxels.keys), np.bool_)
    height_m = labels.above_track(centres)[1]
    for line in labels.described.description.walls_m:
        is_wall |= near_line(centres[:, :2], np.asarray(line)) < WALL_M
    is_wall &= (height_m > WALL_FROM_M) & (height_m < WALL_TO_M)
    return share(labels.voxels.classes[is_wall] == NON_TRAVERSABLE)


def near_line(plan: Array, line: Array) -> Array:
    """Return the distance (N,) of points (N, 2) to a line of corners (L, 2), metres."""
    away = np.full(len(plan), np.inf)
    for start, along in zip(line[:-1], np.diff(line, axis=0), strict=True):
        ratio = np.clip((plan - start) @ along / max(float(along @ along), 1e-12), 0.0, 1.0)
        away = np.minimum(away, np.linalg.norm(plan - start - ratio[:, None] * along, axis=1))
    return away
