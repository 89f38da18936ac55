"""The labelled map of a run for the viewer, tile by tile as reconstructed.

**Conventions.** D² keeps all digits, so that class and threshold never contradict each other. The features are rounded
far below their accuracy, which halves the file.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.domain.viewer.formats import TileMesh, TileVoxels, mesh_bytes, tile_bytes
from services.labeler.frames import LabelledTile
from services.labeler.map.ply import class_at
from services.labeler.run import LabelRun, Tile
from services.labeler.scratch import Arrays, tile_name, whole
from stone.geometry.corners import corners_of
from stone.geometry.lattice import indices_of
from stone.geometry.se3 import SE3
from stone.labels.traversability import Reference, threshold
from stone.sensors.sequence import Sequence
from stone.surface.mesh import Mesh
from stone_base.label_grid import MAP_VOXEL_M, PAPER, LabelGrid

FEATURES = ("elevation_m", "slope_rad", "roughness")
STEPS = np.array([2.0**-10, 2.0**-12, 2.0**-8])  # m, rad, log m²
MOST_TRIANGLES = 40_000


class SceneFiles:
    """Writes the files of one tile after another to `out`, then their index."""

    def __init__(self, run: LabelRun, reference: Reference, out: Path) -> None:
        self._run = run
        description = SceneDescription(
            run.sequence, run.parameters.profile, _reference_record(run, reference), run.parameters.grid
        )
        self._writer = SceneWriter(description, out)

    def add(self, tile: Tile, labelled: LabelledTile) -> None:
        """Write one tile."""
        indices = indices_of(labelled.terrain.keys)
        surface = labelled.mesh
        if not len(indices) and not len(surface["vertices"]):
            return
        features = np.round(labelled.terrain.features(self._run.parameters.rule) / STEPS) * STEPS
        confidence = np.zeros(len(indices), np.uint8) if labelled.confidence is None else labelled.confidence
        voxels = TileVoxels(indices, labelled.classes, features, labelled.squared, confidence)
        corner_m = np.array([tile.i, tile.j, 0.0]) * self._run.parameters.core_m
        mesh = thinned(_surface(surface, labelled), MOST_TRIANGLES)
        self._writer.add(tile_name(tile), voxels, mesh, corner_m)

    def finish(self) -> None:
        """Write `scene.json`."""
        self._writer.finish()


def _reference_record(run: LabelRun, reference: Reference) -> dict[str, Any]:
    return {
        "mean": reference.mean.tolist(),
        "covariance": reference.covariance.tolist(),
        "d2_limit": threshold(run.parameters.reference.alpha),
        "features": list(FEATURES),
    }


def _surface(arrays: Arrays, labelled: LabelledTile) -> TileMesh:
    """Return the triangles of a tile, without unused vertices."""
    used = np.zeros(len(arrays["vertices"]), np.bool_)
    used[arrays["triangles"]] = True
    mesh = Mesh(arrays["vertices"], arrays["triangles"]).where(used)  # type: ignore[arg-type]
    classes = class_at(mesh.vertices_map, labelled.terrain.keys, labelled.classes)  # type: ignore[arg-type]
    return TileMesh(mesh.vertices_map, classes, mesh.triangles)


# Writes a scene for the viewer: its voxels and surface tile by tile, and the index `scene.json`: scene/scene.json,
# scene/tile_<i>_<j>.bin, scene/mesh_<i>_<j>.bin. The binary formats are those of `services/domain/viewer/formats.py`; a
# tile without surface has no files. Stamps are strings, since numbers in browsers lose nanoseconds; poses are (tx, ty,
# tz, qw, qx, qy, qz), to 0.1 mm.


FOLDER, INDEX = "scene", "scene.json"
VERTEX_STEP_M = 2.0**-10
POSE_DIGITS = 4, 8  # metres, quaternion


@dataclass(frozen=True, eq=False)
class SceneDescription:
    """A scene's description of its labels. `reference` is the driven ground, None if voxels have no features.

    `grid` is the grid of the frames; the tiles are on the map's lattice with voxels of `map_voxel_m`.
    """

    sequence: Sequence
    profile: str
    reference: Mapping[str, Any] | None
    grid: LabelGrid = PAPER
    map_voxel_m: float = MAP_VOXEL_M


@dataclass
class SceneWriter:
    """Writes the files of one tile after another to `out`, then their index."""

    about: SceneDescription
    out: Path
    tiles: list[dict[str, Any]] = field(default_factory=list)
    meshes: list[dict[str, Any]] = field(default_factory=list)
    has_confidence: bool = False

    def add(self, name: str, voxels: TileVoxels, mesh: TileMesh, corner_m: NDArray[np.float64]) -> None:
        """Write a tile with its mesh in metres of the map; `corner_m` (3,) is used for a tile without voxels."""
        self.has_confidence |= bool(voxels.confidence.any())
        low, high = corner_m, corner_m
        if len(voxels.indices):
            first, last = corners_of(voxels.indices)
            low, high = first * self.about.map_voxel_m, (last + 1) * self.about.map_voxel_m
        facts = {"name": name, "min_m": _round_pose(low), "max_m": _round_pose(high), "voxels": len(voxels.indices)}
        self.tiles.append(facts | {"bytes": self._write(f"tile_{name}.bin", tile_bytes(voxels))})
        moved = replace(mesh, vertices_m=np.round((mesh.vertices_m - low) / VERTEX_STEP_M) * VERTEX_STEP_M)
        size_bytes = self._write(f"mesh_{name}.bin", mesh_bytes(moved))
        self.meshes.append({"name": name, "triangles": len(mesh.triangles), "bytes": size_bytes})

    def finish(self) -> None:
        """Write `scene.json`."""
        self._write(INDEX, json.dumps(self._record(), separators=(",", ":")).encode())

    def _record(self) -> dict[str, Any]:
        sequence = self.about.sequence
        footprint, frames = sequence.calibration.footprint, sequence.frames
        return {
            "name": sequence.name,
            "profile": self.about.profile,
            "grid": _grid_record(self.about.grid),
            "map_voxel_m": self.about.map_voxel_m,
            "footprint_m": [footprint.length_m, footprint.width_m],
            "reference": self.about.reference,
            "has_confidence": self.has_confidence,
            "frames": {
                "tokens": list(frames.tokens),
                "stamps_ns": [str(stamp) for stamp in frames.stamps_ns.tolist()],
                "map_from_ego": _poses(frames.map_from_ego),
            },
            "tiles": self.tiles,
            "meshes": self.meshes,
        }

    def _write(self, name: str, content: bytes) -> int:
        with whole(self.out / FOLDER / name) as staging:
            staging.write_bytes(content)
        return len(content)


def _grid_record(grid: LabelGrid) -> dict[str, Any]:
    return {"name": grid.name, "shape": list(grid.shape), "min_m": list(grid.min_m), "voxel_m": grid.voxel_m}


def _poses(poses: SE3) -> list[list[float]]:
    metres, digits = POSE_DIGITS
    return np.hstack([poses.translation_m.round(metres), poses.wxyz.round(digits)]).tolist()  # type: ignore[no-any-return]


def _round_pose(corner: NDArray[np.float64]) -> list[float]:
    return [round(float(value), POSE_DIGITS[0]) for value in corner]


# A surface with fewer triangles: vertices that share a cell are replaced by their mean (Rossignac and Borrel, 1993).
# The cell grows by √2 until there are few enough triangles. A cell has the majority class of its vertices, class 0 (in
# no voxel) only if all have it. Triangles keep their orientation. Equal inputs give equal outputs.


FIRST_CELL_M = 0.25
GROWTH = 2.0**0.5
CLASSES = 4
MOST_PACKED = 2**21  # three such numbers fit into 64 bits


def thinned(mesh: TileMesh, most_triangles: int) -> TileMesh:
    """Return at most `most_triangles` (> 0) triangles; smaller meshes are returned unchanged."""
    smaller, cell_m = mesh, FIRST_CELL_M
    while len(smaller.triangles) > most_triangles:
        smaller = _cluster(mesh, cell_m)
        cell_m *= GROWTH
    return smaller


def _cluster(mesh: TileMesh, cell_m: float) -> TileMesh:
    """Return one vertex for each cell of this size that is still a corner of a triangle."""
    vertices = mesh.vertices_m.astype(np.float64)
    rows = _cells(np.floor((vertices - corners_of(vertices)[0]) / cell_m).astype(np.int64))
    corners = rows[mesh.triangles]
    a, b, c = corners.T
    is_flat = (a == b) | (b == c) | (c == a)
    used, renamed = np.unique(_each_once(corners[~is_flat]), return_inverse=True)
    counts = np.bincount(rows)
    means = np.stack([np.bincount(rows, vertices[:, axis]) / counts for axis in range(3)], axis=1)
    return TileMesh(means[used], _most_frequent(rows, mesh.classes)[used], renamed.reshape(-1, 3).astype(np.int32))


def _cells(indices: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return a number from 0 on for the cell of each vertex."""
    sides = corners_of(indices)[1] + 1
    keys = (indices[:, 0] * sides[1] + indices[:, 1]) * sides[2] + indices[:, 2]
    return np.unique(keys, return_inverse=True)[1].reshape(-1)


def _each_once(corners: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the triangles without duplicates, each starting at its smallest corner, sorted."""
    first = corners.argmin(axis=1)
    turned = np.take_along_axis(corners, (first[:, None] + np.arange(3)) % 3, axis=1)
    side = int(corners.max(initial=0)) + 1
    if side > MOST_PACKED:
        return np.unique(turned, axis=0)
    keys = np.sort((turned[:, 0] * side + turned[:, 1]) * side + turned[:, 2])  # a tenth of the time of sorting rows
    keys = keys[np.append(True, keys[1:] != keys[:-1])[: len(keys)]]
    return np.stack([keys // side**2, keys // side % side, keys % side], axis=1)


def _most_frequent(rows: NDArray[np.int64], classes: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the most frequent class 1 to 3 of each cell, the lower if equal; 0 if there is none."""
    votes = np.stack([np.bincount(rows, classes == kind) for kind in range(CLASSES)], axis=1)
    votes[:, 0] = 0.5
    return np.asarray(votes.argmax(axis=1), dtype=np.uint8)
