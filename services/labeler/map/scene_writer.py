"""Writes a scene for the viewer: its voxels and surface tile by tile, and `scene.json`, which says what there is.

    scene/scene.json   scene/tile_<i>_<j>.bin   scene/mesh_<i>_<j>.bin

**Conventions.** The binary formats are those of `services/domain/viewer/formats.py`; a tile without surface has no
files. Stamps are strings, since a browser's numbers lose nanoseconds; poses are (tx, ty, tz, qw, qx, qy, qz), to
0.1 mm.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.domain.viewer.formats import TileMesh, TileVoxels, mesh_bytes, tile_bytes
from services.labeler.scratch import whole
from stone.geometry.corners import corners_of
from stone.geometry.se3 import SE3
from stone.labels.grid import GRID_MIN_M, GRID_SHAPE
from stone.labels.voxels import VOXEL_M
from stone.sensors.sequence import Sequence

FOLDER, INDEX = "scene", "scene.json"
VERTEX_STEP_M = 2.0**-10
POSE_DIGITS = 4, 8  # metres, quaternion


@dataclass(frozen=True, eq=False)
class SceneDescription:
    """What a scene says of its labels. `reference` is the driven ground, None where voxels have no features."""

    sequence: Sequence
    profile: str
    reference: Mapping[str, Any] | None


@dataclass
class SceneWriter:
    """Writes the files of one tile after another below `out`, then the index of them."""

    about: SceneDescription
    out: Path
    tiles: list[dict[str, Any]] = field(default_factory=list)
    meshes: list[dict[str, Any]] = field(default_factory=list)

    def add(self, name: str, voxels: TileVoxels, mesh: TileMesh, corner_m: NDArray[np.float64]) -> None:
        """A tile; its mesh in metres of the map. `corner_m` (3,) is where one without voxels lies."""
        low, high = corner_m, corner_m
        if len(voxels.indices):
            first, last = corners_of(voxels.indices)
            low, high = first * VOXEL_M, (last + 1) * VOXEL_M
        facts = {"name": name, "min_m": _rounded(low), "max_m": _rounded(high), "voxels": len(voxels.indices)}
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
            "grid": {"shape": list(GRID_SHAPE), "min_m": list(GRID_MIN_M), "voxel_m": VOXEL_M},
            "footprint_m": [footprint.length_m, footprint.width_m],
            "reference": self.about.reference,
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


def _poses(poses: SE3) -> list[list[float]]:
    metres, digits = POSE_DIGITS
    return np.hstack([poses.translation_m.round(metres), poses.wxyz.round(digits)]).tolist()  # type: ignore[no-any-return]


def _rounded(corner: NDArray[np.float64]) -> list[float]:
    return [round(float(value), POSE_DIGITS[0]) for value in corner]
