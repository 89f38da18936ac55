"""The labelled map for the viewer: its voxels and surface tile by tile, and `scene.json`, which says what there is.

    scene/scene.json   scene/tile_<i>_<j>.bin   scene/mesh_<i>_<j>.bin

**Conventions.** The binary formats are those of `services/domain/viewer/formats.py`, tiles those of the reconstruction;
a tile without surface has no files. Stamps are strings, since a browser's numbers lose nanoseconds; poses are
(tx, ty, tz, qw, qx, qy, qz), to 0.1 mm. D² keeps all its digits, so that class and threshold never contradict each
other; the features are rounded to far below what they mean, which halves the file.
"""

import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.domain.viewer.formats import TileMesh, TileVoxels, mesh_bytes, tile_bytes
from services.labeler.map.ply import class_at
from services.labeler.map.thinning import thinned
from services.labeler.run import LabelRun, Tile
from services.labeler.scratch import Arrays, tile_name, whole
from stone.geometry.lattice import indices_of
from stone.labels.grid import GRID_MIN_M, GRID_SHAPE
from stone.labels.traversability import Reference, distance_squared, threshold
from stone.labels.voxels import VOXEL_M

FOLDER, INDEX = "scene", "scene.json"
FEATURES = ("elevation_m", "slope_rad", "roughness")
STEPS = np.array([2.0**-10, 2.0**-12, 2.0**-8])  # of a metre, a radian, a log m²
MOST_TRIANGLES = 40_000
POSE_DIGITS = 4, 8  # metres, quaternion


@dataclass
class SceneFiles:
    """Writes the files of one tile after another below `out`, then the index of them."""

    run: LabelRun
    reference: Reference
    out: Path
    tiles: list[dict[str, Any]] = field(default_factory=list)
    meshes: list[dict[str, Any]] = field(default_factory=list)

    def add(self, tile: Tile, arrays: Arrays, classes: NDArray[np.uint8]) -> None:
        """The tile that the surface stage left as `arrays`, its voxels of these classes (K,)."""
        name = tile_name(tile)
        indices = indices_of(arrays["keys"])  # type: ignore[arg-type]
        if not len(indices) and not len(arrays["vertices"]):
            return
        low, high = self._extent(tile, indices)
        features: NDArray[np.float64] = arrays["features"]  # type: ignore[assignment]
        squared = distance_squared(features, self.reference)
        voxels = TileVoxels(indices, classes, np.round(features / STEPS) * STEPS, squared)
        facts = {"name": name, "min_m": _rounded(low), "max_m": _rounded(high), "voxels": len(indices)}
        self.tiles.append(facts | {"bytes": self._write(f"tile_{name}.bin", tile_bytes(voxels))})
        mesh = thinned(_surface(arrays, classes), MOST_TRIANGLES)
        moved = replace(mesh, vertices_m=np.round((mesh.vertices_m - low) / STEPS[0]) * STEPS[0])
        size_bytes = self._write(f"mesh_{name}.bin", mesh_bytes(moved))
        self.meshes.append({"name": name, "triangles": len(mesh.triangles), "bytes": size_bytes})

    def finish(self) -> None:
        """Write `scene.json`."""
        self._write(INDEX, json.dumps(self._record(), separators=(",", ":")).encode())

    def _record(self) -> dict[str, Any]:
        run, reference = self.run, self.reference
        footprint = run.sequence.calibration.footprint
        return {
            "name": run.sequence.name,
            "profile": run.parameters.profile,
            "grid": {"shape": list(GRID_SHAPE), "min_m": list(GRID_MIN_M), "voxel_m": VOXEL_M},
            "footprint_m": [footprint.length_m, footprint.width_m],
            "reference": {
                "mean": reference.mean.tolist(),
                "covariance": reference.covariance.tolist(),
                "d2_limit": threshold(run.parameters.reference.alpha),
                "features": list(FEATURES),
            },
            "frames": {
                "tokens": list(run.sequence.frames.tokens),
                "stamps_ns": [str(stamp) for stamp in run.sequence.frames.stamps_ns.tolist()],
                "map_from_ego": _poses(run),
            },
            "tiles": self.tiles,
            "meshes": self.meshes,
        }

    def _extent(self, tile: Tile, indices: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The corners (3,) of the box around the voxels, metres; of a tile without any, of its core's bottom."""
        if len(indices):
            return indices.min(axis=0) * VOXEL_M, (indices.max(axis=0) + 1) * VOXEL_M
        low = np.array([tile.i, tile.j, 0.0]) * self.run.parameters.core_m
        return low, low

    def _write(self, name: str, content: bytes) -> int:
        with whole(self.out / FOLDER / name) as staging:
            staging.write_bytes(content)
        return len(content)


def _surface(arrays: Arrays, classes: NDArray[np.uint8]) -> TileMesh:
    vertices: NDArray[np.float32] = arrays["vertices"]  # type: ignore[assignment]
    kinds = class_at(vertices, arrays["keys"], classes)  # type: ignore[arg-type]
    return TileMesh(vertices, kinds, arrays["triangles"])  # type: ignore[arg-type]


def _poses(run: LabelRun) -> list[list[float]]:
    poses = run.sequence.frames.map_from_ego
    metres, digits = POSE_DIGITS
    return np.hstack([poses.translation_m.round(metres), poses.wxyz.round(digits)]).tolist()  # type: ignore[no-any-return]


def _rounded(corner: NDArray[np.float64]) -> list[float]:
    return [round(float(value), POSE_DIGITS[0]) for value in corner]
