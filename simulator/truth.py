"""Ground truth of a simulation: exact terrain, exact poses and drivability.

**Conventions.** World = map of the simulation; heights are lattice points (`height_m[i, j]` at origin + (j, i) ·
resolution). A judged point lies on the ground's surface or inside an obstacle; grass, crowns, the walker's trail and
air are not judged. The folder contains `heightfield.npz`, `poses.npz` and `world.json`.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from simulator.options import SimulateOptions
from simulator.scenery.objects import OBSTACLE
from simulator.scenery.path import POSE_NS, DriveTrajectory
from simulator.scenery.terrain import bilinear
from simulator.scenery.world import ORIGIN_DEG_M, SimulatedWorld, drivability
from stone.errors import Refused
from stone.geometry.se3 import SE3, Array

TRUTH_MARK = "world.json"
NOT_JUDGED, DRIVABLE, NOT_DRIVABLE = 0, 1, 2
SURFACE_BAND_M = 0.25  # half a 0.2 m voxel's diagonal, and the mesh's own error
OBSTACLE_MARGIN_M = 0.1
OBSTACLE_CELL_M = 0.1


def truth_folder(folder: Path, reason: str) -> Refused:
    return Refused(
        "not_a_truth_folder", f"{folder} contains no simulated truth ({reason}); write one with stone simulate --truth"
    )


@dataclass(frozen=True, eq=False)
class SimulationTruth:
    """Lattice fields (ny, nx), the drive, and the sweeps' stamps (S,)."""

    height_m: Array
    slope_field_rad: Array
    is_drivable: NDArray[np.bool_]
    obstacles: NDArray[np.void]
    obstacle_top_m: NDArray[np.float32]
    trajectory: DriveTrajectory
    sweep_stamps_ns: NDArray[np.int64]
    origin_m: tuple[float, float]
    resolution_m: float

    def map_from_ego(self, stamp_ns: int) -> SE3:
        """Return the exact pose at this stamp. Raises `stamp_outside_truth` outside the drive."""
        stamps = self.trajectory.stamps_ns
        if not stamps[0] <= stamp_ns <= stamps[-1]:
            raise Refused(
                "stamp_outside_truth",
                f"stamp {stamp_ns} ns is outside the simulated drive {int(stamps[0])}..{int(stamps[-1])} ns; "
                "another recording's truth?",
            )
        return self.trajectory.at(np.array([stamp_ns], np.int64))[0]

    def elevation_m(self, xy: Array) -> Array:
        """Return the ground height at (..., 2)."""
        return bilinear(self.height_m, self._lattice(xy))

    def slope_rad(self, xy: Array) -> Array:
        """Return the slope at the robot's scale at (..., 2)."""
        return bilinear(self.slope_field_rad, self._lattice(xy))

    def judge(self, centres_map: Array) -> NDArray[np.uint8]:
        """Return 0 not judged, 1 drivable ground or 2 not drivable, for points (N, 3)."""
        xy = centres_map[:, :2]
        rows, columns = self.height_m.shape
        column, row = np.round(self._lattice(xy)).astype(np.int64).T
        is_inside = (column >= 0) & (row >= 0) & (column < columns) & (row < rows)
        column, row = np.clip(column, 0, columns - 1), np.clip(row, 0, rows - 1)
        above = (centres_map[:, 2] - self.elevation_m(xy)) * np.cos(self.slope_field_rad[row, column])
        is_surface = np.abs(above) <= SURFACE_BAND_M
        is_obstacle = (above > -SURFACE_BAND_M) & (centres_map[:, 2] < self._obstacle_top(xy))
        verdict = np.where(is_surface & self.is_drivable[row, column], DRIVABLE, NOT_JUDGED)
        verdict[is_obstacle | (is_surface & ~self.is_drivable[row, column])] = NOT_DRIVABLE
        verdict[~is_inside] = NOT_JUDGED
        return verdict.astype(np.uint8)

    def _lattice(self, xy: Array) -> Array:
        return np.asarray((xy - np.asarray(self.origin_m)) / self.resolution_m)

    def _obstacle_top(self, xy: Array) -> NDArray[np.float32]:
        cell = np.floor((xy - np.asarray(self.origin_m)) / OBSTACLE_CELL_M).astype(np.int64)
        rows, columns = self.obstacle_top_m.shape
        column, row = np.clip(cell[:, 0], 0, columns - 1), np.clip(cell[:, 1], 0, rows - 1)
        return np.asarray(self.obstacle_top_m[row, column])


@dataclass(frozen=True, eq=False)
class TruthGround:
    """The inputs of the truth: heights (ny, nx) on a lattice and the obstacles on them."""

    height_m: Array
    obstacles: NDArray[np.void]
    origin_m: tuple[float, float]
    resolution_m: float


def truth_of(world: SimulatedWorld, sweep_stamps_ns: list[int]) -> SimulationTruth:
    """Return the truth of a world in memory."""
    terrain = world.terrain
    ground = TruthGround(terrain.height_m, world.objects.obstacles, terrain.origin_m, terrain.resolution_m)
    return truth_over(ground, world.trajectory, np.array(sweep_stamps_ns, np.int64))


def truth_over(ground: TruthGround, trajectory: DriveTrajectory, sweep_stamps_ns: NDArray[np.int64]) -> SimulationTruth:
    """Return the truth of a drive over this ground."""
    fields = drivability(ground.height_m, ground.resolution_m)
    rows, columns = ground.height_m.shape
    extent = ((columns - 1) * ground.resolution_m, (rows - 1) * ground.resolution_m)
    return SimulationTruth(
        ground.height_m,
        fields.slope_rad,
        fields.is_drivable,
        ground.obstacles,
        obstacle_tops(ground.obstacles, ground.origin_m, extent),
        trajectory,
        sweep_stamps_ns,
        ground.origin_m,
        ground.resolution_m,
    )


def obstacle_tops(
    obstacles: NDArray[np.void], origin_m: tuple[float, float], extent_m: tuple[float, float]
) -> NDArray[np.float32]:
    """Return the height of the highest obstacle per `OBSTACLE_CELL_M` cell; −inf without an obstacle."""
    shape = (int(extent_m[1] / OBSTACLE_CELL_M) + 1, int(extent_m[0] / OBSTACLE_CELL_M) + 1)
    tops = np.full(shape, -np.inf, np.float32)
    for obstacle in obstacles:
        reach = obstacle["radius"] + OBSTACLE_MARGIN_M
        x, y = obstacle["x"] - origin_m[0], obstacle["y"] - origin_m[1]
        columns = np.arange(max(0, int((x - reach) / OBSTACLE_CELL_M)), int((x + reach) / OBSTACLE_CELL_M) + 1)
        rows = np.arange(max(0, int((y - reach) / OBSTACLE_CELL_M)), int((y + reach) / OBSTACLE_CELL_M) + 1)
        columns, rows = columns[columns < shape[1]], rows[rows < shape[0]]
        far = np.hypot((columns + 0.5) * OBSTACLE_CELL_M - x, ((rows + 0.5) * OBSTACLE_CELL_M - y)[:, None])
        window = np.ix_(rows, columns)
        top = np.float32(obstacle["top"] + OBSTACLE_MARGIN_M)
        tops[window] = np.where(far <= reach, np.maximum(tops[window], top), tops[window])
    return tops


def write_truth(truth: SimulationTruth, options: SimulateOptions, folder: Path) -> None:
    """Write the truth into an empty folder."""
    np.savez_compressed(
        folder / "heightfield.npz",
        height_m=truth.height_m,
        is_drivable=truth.is_drivable,
        slope_rad=truth.slope_field_rad.astype(np.float32),
        origin_m=np.array(truth.origin_m),
        resolution_m=np.array(truth.resolution_m),
        obstacles=truth.obstacles,
    )
    np.savez(
        folder / "poses.npz",
        stamps_ns=truth.trajectory.stamps_ns,
        map_from_ego=truth.trajectory.map_from_ego.wxyz_xyz,
        sweep_stamps_ns=truth.sweep_stamps_ns,
    )
    record = {"stone_truth": 1, "map_origin_deg_m": list(ORIGIN_DEG_M), "options": asdict(options)}
    (folder / TRUTH_MARK).write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")


def read_truth(folder: Path) -> SimulationTruth:
    """Return the truth written by `stone simulate --truth`. Raises `not_a_truth_folder`."""
    try:
        json.loads((folder / TRUTH_MARK).read_text(encoding="utf-8"))["stone_truth"]
        with np.load(folder / "heightfield.npz") as ground, np.load(folder / "poses.npz") as drive:
            stamps = drive["stamps_ns"]
            _check_stamps(folder, stamps)
            trajectory = DriveTrajectory(int(stamps[0]), SE3(drive["map_from_ego"]))
            return truth_over(_ground(ground), trajectory, drive["sweep_stamps_ns"])
    except (OSError, KeyError, TypeError, ValueError, BadZipFile) as error:
        raise truth_folder(folder, str(error)) from error


def _ground(fields: Mapping[str, NDArray[Any]]) -> TruthGround:
    x, y = fields["origin_m"].tolist()
    obstacles = fields["obstacles"].astype(OBSTACLE)
    return TruthGround(fields["height_m"], obstacles, (float(x), float(y)), float(fields["resolution_m"]))


def _check_stamps(folder: Path, stamps_ns: NDArray[np.int64]) -> None:
    if len(stamps_ns) < 2 or np.any(np.diff(stamps_ns) != POSE_NS):
        raise truth_folder(folder, f"poses are not {POSE_NS} ns apart")
