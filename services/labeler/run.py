"""One labelling run as a value, and how its work is divided into parts and tiles.

**Conventions.** A run has one map, or several where its track breaks (`stone.sensors.ego_path`); each is divided as
if it were alone. A tile is named by its integer place (i, j) and its map; its core is [i, i+1) × [j, j+1) times
`core_m`. Cores tile the plane; the cube a tile is reconstructed in reaches `halo_m` beyond. A part is a half-open range
of frames of one map. The division depends on the frames and the parameters, never on the number of workers.
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
    """A square of the map of this number: its place in multiples of `core_m`."""

    i: int
    j: int
    map: int = 0

    @property
    def place(self) -> NDArray[np.int64]:
        """(i, j) as an array (2,)."""
        return np.array([self.i, self.j], np.int64)


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

    @cached_property
    def maps(self) -> NDArray[np.int64]:
        """The map (N,) of each frame."""
        return maps_of_frames(self.sequence)

    @cached_property
    def way_starts_m(self) -> NDArray[np.float64]:
        """Return how far the robot had driven before each map (M,), as the pieces of its way through them add up."""
        stretches = (ego_path(self.sequence, number) for number in range(int(self.maps.max(initial=0)) + 1))
        lengths_m = [sum(float(steps_of(stretch)[0].sum()) for stretch in path) for path in stretches]
        return np.cumsum([0.0, *lengths_m[:-1]])

    @property
    def period_s(self) -> float:
        """From one frame to the next, as it usually is; 0.1 s where there is but one."""
        stamps_ns = self.sequence.frames.stamps_ns
        return float(np.median(np.diff(stamps_ns))) * 1e-9 if len(stamps_ns) > 1 else USUAL_PERIOD_S

    def every(self, frames: int) -> int:
        """Which frames a stage takes that takes one of so many at 10 Hz: at slower rates, in as much time, not more."""
        return max(1, min(frames, round(frames * USUAL_PERIOD_S / self.period_s)))

    def map_of(self, part: Part) -> int:
        """The map that all frames of the part are in."""
        return int(self.maps[part[0]])


def require_ground(run: LabelRun) -> None:
    """Raises `footprint_off_ground` where the footprint is not on the ground, `poses_tilted` where the poses are."""
    refusal = ground_refusal(run.sequence, run.parameters.footprint_band_m)
    if refusal is not None:
        raise refusal


def parts_of(run: LabelRun) -> list[Part]:
    """The frame ranges that are fused, and later cropped, as one task each."""
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
    """How many voxels of this size make the side of a core."""
    return round(parameters.core_m / voxel_m)


def tiles_of(keys: Keys, cells: int) -> NDArray[np.int64]:
    """The tile (N, 2) of each voxel key (N,), for cores of `cells` voxels a side."""
    return indices_of(keys)[:, :2] // cells


def tiles_across(parameters: LabelParameters, bounds: Bounds, number: int) -> list[Tile]:
    """The tiles of a map that a half-open range of label voxel indices (low, high), each (2,) or (3,), reaches into."""
    low, high = bounds
    cells = core_cells(parameters, VOXEL_M)
    first, last = low[:2] // cells, (high[:2] - 1) // cells
    return [Tile(int(i), int(j), number) for i in range(first[0], last[0] + 1) for j in range(first[1], last[1] + 1)]


def neighbourhood(tile: Tile) -> list[Tile]:
    """The tile and the eight around it."""
    return [Tile(tile.i + di, tile.j + dj, tile.map) for di in (-1, 0, 1) for dj in (-1, 0, 1)]


def in_core(points_map: NDArray[np.float64], tile: Tile, core_m: float) -> NDArray[np.bool_]:
    """Which points (N, 3) lie in the core of the tile, in plan."""
    x, y = np.floor(points_map[:, 0] / core_m), np.floor(points_map[:, 1] / core_m)
    return np.asarray((x == tile.i) & (y == tile.j))
