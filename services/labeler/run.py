"""One labelling run as a value, and how its work is divided into parts and tiles.

**Conventions.** A tile is named by its integer place (i, j); its core is [i, i+1) × [j, j+1) times `core_m` in the map.
Cores tile the plane; the cube a tile is reconstructed in reaches `halo_m` beyond. A part is a half-open range of
frames. The division depends on the parameters alone, never on the number of workers.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from services.labeler.parameters import LabelParameters
from stone.geometry.lattice import Keys, indices_of
from stone.labels.voxels import VOXEL_M
from stone.sensors.sequence import Sequence, SweepSource

Tile = tuple[int, int]
Part = tuple[int, int]
Step = Callable[[int, int], None]


def silent(_done: int, _total: int) -> None:
    """Nobody asks how far the stage is."""


@dataclass(frozen=True, eq=False)
class LabelRun:
    """What is labelled, how, and the folder that stages hand their results on in.

    With a `labels_root` the labels of a frame become `<labels_root>/<frame_token>/labels.npz`, else they are appended
    to the pack of their part.
    """

    sequence: Sequence
    sweeps: SweepSource
    parameters: LabelParameters
    scratch: Path
    labels_root: Path | None = None

    @property
    def sensor_ego(self) -> NDArray[np.float64]:
        """Where the LiDAR sits in the ego frame (3,), metres."""
        return self.sequence.calibration.ego_from_lidar.translation_m


def parts_of(run: LabelRun) -> list[Part]:
    """The frame ranges that are fused, and later cropped, as one task each."""
    size, total = run.parameters.tiling.frames_per_part, len(run.sequence.frames)
    return [(begin, min(begin + size, total)) for begin in range(0, total, size)]


def core_cells(parameters: LabelParameters, voxel_m: float) -> int:
    """How many voxels of this size make the side of a core."""
    return round(parameters.core_m / voxel_m)


def tiles_of(keys: Keys, cells: int) -> NDArray[np.int64]:
    """The tile (N, 2) of each voxel key (N,), for cores of `cells` voxels a side."""
    return indices_of(keys)[:, :2] // cells


def tiles_across(parameters: LabelParameters, low: NDArray[np.int64], high: NDArray[np.int64]) -> list[Tile]:
    """The tiles that a half-open range of label voxel indices (2,) or (3,) reaches into."""
    cells = core_cells(parameters, VOXEL_M)
    first, last = low[:2] // cells, (high[:2] - 1) // cells
    return [(int(i), int(j)) for i in range(first[0], last[0] + 1) for j in range(first[1], last[1] + 1)]


def neighbourhood(tile: Tile) -> list[Tile]:
    """The tile and the eight around it."""
    return [(tile[0] + di, tile[1] + dj) for di in (-1, 0, 1) for dj in (-1, 0, 1)]


def in_core(points_map: NDArray[np.float64], tile: Tile, core_m: float) -> NDArray[np.bool_]:
    """Which points (N, 3) lie in the core of the tile, in plan."""
    return np.asarray((np.floor(points_map[:, :2] / core_m) == np.array(tile)).all(axis=1), dtype=np.bool_)
