"""The labelled map of a run for the viewer, tile by tile as it was reconstructed.

**Conventions.** D² keeps all its digits, so that class and threshold never contradict each other; the features are
rounded to far below what they mean, which halves the file.
"""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.domain.viewer.formats import TileMesh, TileVoxels
from services.labeler.map.ply import class_at
from services.labeler.map.scene_writer import SceneDescription, SceneWriter
from services.labeler.map.thinning import thinned
from services.labeler.run import LabelRun, Tile
from services.labeler.scratch import Arrays, tile_name
from stone.geometry.lattice import indices_of
from stone.labels.traversability import Reference, distance_squared, threshold

FEATURES = ("elevation_m", "slope_rad", "roughness")
STEPS = np.array([2.0**-10, 2.0**-12, 2.0**-8])  # of a metre, a radian, a log m²
MOST_TRIANGLES = 40_000


class SceneFiles:
    """Writes the files of one tile after another below `out`, then the index of them."""

    def __init__(self, run: LabelRun, reference: Reference, out: Path) -> None:
        self._run, self._reference = run, reference
        said = SceneDescription(run.sequence, run.parameters.profile, _reference_record(run, reference))
        self._writer = SceneWriter(said, out)

    def add(self, tile: Tile, arrays: Arrays, classes: NDArray[np.uint8]) -> None:
        """The tile that the surface stage left as `arrays`, its voxels of these classes (K,)."""
        indices = indices_of(arrays["keys"])  # type: ignore[arg-type]
        if not len(indices) and not len(arrays["vertices"]):
            return
        features: NDArray[np.float64] = arrays["features"]  # type: ignore[assignment]
        squared = distance_squared(features, self._reference)
        voxels = TileVoxels(indices, classes, np.round(features / STEPS) * STEPS, squared)
        corner_m = np.array([tile.i, tile.j, 0.0]) * self._run.parameters.core_m
        self._writer.add(tile_name(tile), voxels, thinned(_surface(arrays, classes), MOST_TRIANGLES), corner_m)

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


def _surface(arrays: Arrays, classes: NDArray[np.uint8]) -> TileMesh:
    vertices: NDArray[np.float32] = arrays["vertices"]  # type: ignore[assignment]
    kinds = class_at(vertices, arrays["keys"], classes)  # type: ignore[arg-type]
    return TileMesh(vertices, kinds, arrays["triangles"])  # type: ignore[arg-type]
