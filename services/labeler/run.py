"""One labelling run as a value, and the division of its work into parts and tiles.

**Conventions.** A run has one map, or several if its track breaks (`stone.sensors.ego_path`); each is divided
separately. A tile is identified by its integer position (i, j) and its map; its core is [i, i+1) × [j, j+1) times
`core_m`. Cores tile the plane; the cube in which a tile is reconstructed extends `halo_m` beyond. A part is a half-open
range of frames of one map. The division depends on the frames and the parameters, never on the number of workers.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from services.labeler.parameters import LabelParameters
from stone.geometry.lattice import Keys, indices_of
from stone.geometry.se3 import steps_of
from stone.labels.grid import Bounds
from stone.labels.voxels import VOXEL_M
from stone.sensors.ego_path import ego_path, maps_of_frames
from stone.sensors.ground_refusals import ground_refusal
from stone.sensors.sequence import Sequence, SweepSource

USUAL_PERIOD_S = 0.1

Part = tuple[int, int]
Step = Callable[[int, int], None]


class Tile(NamedTuple):
    """A square of the map with this number: its position in multiples of `core_m`."""

    i: int
    j: int
    map: int = 0

    @property
    def place(self) -> NDArray[np.int64]:
        """(i, j) as an array (2,)."""
        return np.array([self.i, self.j], np.int64)


def silent(_done: int, _total: int) -> None:
    """Ignore progress; the default callback."""


@dataclass(frozen=True, eq=False)
class LabelRun:
    """The sequence and parameters of a run, and the folder through which stages exchange results.

    With a `labels_root` the labels of a frame become `<labels_root>/<frame_token>/labels.npz`; otherwise they are
    appended to the pack of their part.
    """

    sequence: Sequence
    sweeps: SweepSource
    parameters: LabelParameters
    scratch: Path
    labels_root: Path | None = None

    @property
    def sensor_ego(self) -> NDArray[np.float64]:
        """The position (3,) of the LiDAR in the ego frame, metres."""
        return self.sequence.calibration.ego_from_lidar.translation_m

    @cached_property
    def maps(self) -> NDArray[np.int64]:
        """The map (N,) of each frame."""
        return maps_of_frames(self.sequence)

    @cached_property
    def way_starts_m(self) -> NDArray[np.float64]:
        """The driven distance before each map (M,), summed over the track in earlier maps."""
        stretches = (ego_path(self.sequence, number) for number in range(int(self.maps.max(initial=0)) + 1))
        lengths_m = [sum(float(steps_of(stretch)[0].sum()) for stretch in path) for path in stretches]
        return np.cumsum([0.0, *lengths_m[:-1]])

    @property
    def period_s(self) -> float:
        """The usual interval between frames; 0.1 s for a single frame."""
        stamps_ns = self.sequence.frames.stamps_ns
        return float(np.median(np.diff(stamps_ns))) * 1e-9 if len(stamps_ns) > 1 else USUAL_PERIOD_S

    def every(self, frames: int) -> int:
        """Return the frame step that covers the same time as `frames` frames at 10 Hz; at least 1."""
        return max(1, min(frames, round(frames * USUAL_PERIOD_S / self.period_s)))

    def map_of(self, part: Part) -> int:
        """Return the map of all frames of the part."""
        return int(self.maps[part[0]])


def require_ground(run: LabelRun) -> None:
    """Raise `footprint_off_ground` if the footprint is not on the ground, `poses_tilted` if the poses are tilted."""
    refusal = ground_refusal(run.sequence, run.parameters.footprint_band_m)
    if refusal is not None:
        raise refusal


def parts_of(run: LabelRun) -> list[Part]:
    """Return the frame ranges that are fused, and later cropped, as one task each."""
    size, total = run.parameters.tiling.frames_per_part, len(run.sequence.frames)
    if not total:
        return []
    breaks = (np.flatnonzero(np.diff(run.maps)) + 1).tolist()
    return [
        (begin, min(begin + size, end))
        for start, end in pairwise([0, *breaks, total])
        for begin in range(start, end, size)
    ]


def core_cells(parameters: LabelParameters, voxel_m: float) -> int:
    """Return the number of voxels of this size on the side of a core."""
    return round(parameters.core_m / voxel_m)


def tiles_of(keys: Keys, cells: int) -> NDArray[np.int64]:
    """Return the tile (N, 2) of each voxel key (N,), for cores of `cells` voxels a side."""
    return indices_of(keys)[:, :2] // cells


def tiles_across(parameters: LabelParameters, bounds: Bounds, number: int) -> list[Tile]:
    """Return a map's tiles that overlap a half-open range of label voxel indices (low, high), each (2,) or (3,)."""
    low, high = bounds
    cells = core_cells(parameters, VOXEL_M)
    first, last = low[:2] // cells, (high[:2] - 1) // cells
    return [Tile(int(i), int(j), number) for i in range(first[0], last[0] + 1) for j in range(first[1], last[1] + 1)]


def neighbourhood(tile: Tile) -> list[Tile]:
    """Return the tile and its eight neighbours."""
    return [Tile(tile.i + di, tile.j + dj, tile.map) for di in (-1, 0, 1) for dj in (-1, 0, 1)]


def in_core(points_map: NDArray[np.float64], tile: Tile, core_m: float) -> NDArray[np.bool_]:
    """Return a mask of the points (N, 3) in the core of the tile, in plan."""
    x, y = np.floor(points_map[:, 0] / core_m), np.floor(points_map[:, 1] / core_m)
    return np.asarray((x == tile.i) & (y == tile.j))
