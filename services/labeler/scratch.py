"""What one stage leaves for the next: arrays in files that appear whole.

**Conventions.** A file is written beside its place and renamed in, so a killed worker leaves nothing half-written and
a stage that runs twice writes the same bytes. All of it is deleted when the run ends.
"""

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from services.labeler.run import Part, Run, Tile
from stone.observed import Observed
from stone.pointmap import PointMap

Arrays = dict[str, NDArray[np.generic]]


def save(path: Path, arrays: Arrays) -> None:
    """Write arrays to `path` (.npz, stored), atomically."""
    path.parent.mkdir(parents=True, exist_ok=True)
    staging = path.with_name(f".{path.name}.{os.getpid()}")
    with staging.open("wb") as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]
    staging.replace(path)


def load(path: Path) -> Arrays:
    """The arrays saved at `path`."""
    with np.load(path, allow_pickle=False) as archive:
        return {name: archive[name] for name in archive.files}


def fused_path(run: Run, tile: Tile, part: Part) -> Path:
    return run.scratch / "fused" / f"{tile[0]}_{tile[1]}" / f"{part[0]:06d}.npz"


def images_path(run: Run, part: Part) -> Path:
    return run.scratch / "images" / f"{part[0]:06d}.npz"


def surface_path(run: Run, tile: Tile) -> Path:
    return run.scratch / "surface" / f"{tile[0]}_{tile[1]}.npz"


def sight_path(run: Run, channel: str) -> Path:
    return run.scratch / "sight" / f"{channel}.npz"


def fused_tiles(run: Run) -> list[Tile]:
    """The tiles into which any point fell, in order."""
    names = (folder.name.split("_") for folder in (run.scratch / "fused").glob("*_*"))
    return sorted((int(i), int(j)) for i, j in names)


def load_fused(run: Run, tile: Tile) -> list[tuple[PointMap, Observed]]:
    """The point map and the observed voxels of this tile, part by part; empty where nothing fell."""
    found = []
    for path in sorted((run.scratch / "fused" / f"{tile[0]}_{tile[1]}").glob("[0-9]*.npz")):
        arrays = load(path)
        points = PointMap(run.parameters.surface.point_voxel_m, arrays["keys"], arrays["moments"])  # type: ignore[arg-type]
        found.append((points, Observed(arrays["bricks"], arrays["words"])))  # type: ignore[arg-type]
    return found
