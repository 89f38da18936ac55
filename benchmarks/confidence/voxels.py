"""Voxels of profile `field` with the properties that determine their confidence, and their true drivability.

**Conventions.** A map voxel is placed in the world by the exact pose of the frame nearest in plan. Truth follows the
vehicle's limits in both kinds of worlds (`testing.outside.truth`); grey places are not drivable. T is left out, as the
robot was there. The weight of a voxel is the number of frames whose grid contains it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, map_coordinates
from scipy.spatial import cKDTree

from benchmarks.outside.variants import run_stages
from benchmarks.truth.__main__ import simulated
from services.ingest.sequence import open_sequence
from services.labeler.frames import labelled_tile
from services.labeler.parameters import parameters_for
from services.labeler.pipeline import FUSE, REFERENCE, SURFACE
from services.labeler.results import load_reference, load_summaries
from services.labeler.run import LabelRun
from simulator.options import SimulateOptions
from simulator.truth import NOT_DRIVABLE, SimulationTruth
from stone.geometry.lattice import centres_of
from stone.labels.confidence import CALIBRATED, properties_of
from stone.labels.traversability import POTENTIAL, TRAVERSABLE, threshold
from stone.labels.voxels import VOXEL_M
from stone.sensors.sequence import Sequence, SweepSource
from testing.outside import truth as outside
from testing.outside.drive import OutsideDrive
from testing.outside.verdict import world_from_ego

GRID_HALF_M, EVERY = 25.6, 5
Array = NDArray[np.float64]
Judge = Callable[[Array], NDArray[np.uint8]]  # points (N, 3) of the world to 0 not judged, 1 drivable or another value


@dataclass(frozen=True, eq=False)
class JudgedVoxels:
    """K voxels.

    `properties` (K, n), by `names`; `is_drivable` in truth (K,); `is_kept` (K,), labelled P and not N; their `weight`
    (K,).
    """

    names: tuple[str, ...]
    properties: Array
    is_drivable: NDArray[np.bool_]
    is_kept: NDArray[np.bool_]
    weight: Array


@dataclass(frozen=True)
class OutsideVoxels:
    """An analytic drive with a fault."""

    drive: OutsideDrive
    fault: str = "sound"

    @property
    def name(self) -> str:
        return f"{self.drive.name} {self.fault}"

    def voxels(self, folder: Path) -> JudgedVoxels:
        """Return the voxels of the drive; its ideal ranges are stored in the folder."""
        with TemporaryDirectory(dir=folder) as temporary:
            bag, calibration, data = self.drive.record(folder, self.fault, Path(temporary) / "recording")
            sequence, sweeps = open_sequence(bag, calibration, "outside")
            truth = self.drive.truth
            poses = world_from_ego(truth, sequence.frames.stamps_ns, data.ego_from_lidar)
            return _voxels(sequence, sweeps, poses, lambda points: truth.judge(points).codes)


@dataclass(frozen=True)
class SimulatedVoxels:
    """A drive through a simulated world."""

    options: SimulateOptions

    @property
    def name(self) -> str:
        options = self.options
        further = [name for name in ("range_noise", "beside_track") if getattr(options, name)]
        return " ".join((f"simulated-{options.seed}-{options.channels}-{options.seconds:g}s", *further))

    def voxels(self, folder: Path) -> JudgedVoxels:
        """Return the voxels of the drive; its recording is stored in the folder."""
        drive = simulated(folder / f"{self.name.replace(' ', '-')}.mcap", self.options)
        return _voxels(drive.sequence, drive.sweeps, drive.world_from_ego().as_matrix(), _vehicle_judge(drive.truth))


def kept_voxels(source: OutsideVoxels | SimulatedVoxels, folder: Path) -> JudgedVoxels:
    """Return the voxels of a source, from the folder if an earlier run stored them."""
    path = folder / f"{source.name}.npz"
    if not path.exists():
        np.savez(path.with_suffix(".part.npz"), **vars(source.voxels(folder)))
        path.with_suffix(".part.npz").rename(path)
    with np.load(path) as kept:
        arrays = dict(kept)
    return JudgedVoxels(tuple(arrays.pop("names").tolist()), **arrays)


def _voxels(sequence: Sequence, sweeps: SweepSource, poses: Array, judge: Judge) -> JudgedVoxels:
    """Return the voxels of a run whose ego frames have these poses (F, 4, 4) in the world."""
    map_from_ego = sequence.frames.map_from_ego.as_matrix()
    world_from_map, near = poses @ np.linalg.inv(map_from_ego), cKDTree(map_from_ego[:, :2, 3])
    frames_columns = list[tuple[Array, ...]]()
    names: tuple[str, ...] = ()
    with TemporaryDirectory() as scratch:
        run = LabelRun(sequence, sweeps, parameters_for(CALIBRATED), Path(scratch))
        run_stages(run, (FUSE, SURFACE, REFERENCE))
        reference = load_reference(run)
        limits = (sequence.calibration.vehicle, threshold(run.parameters.reference.alpha))
        for summary in load_summaries(run):
            tile = labelled_tile(run, summary.tile, reference)
            centres = centres_of(tile.terrain.keys, VOXEL_M)
            pose = world_from_map[near.query(centres[:, :2])[1]]
            codes = judge(np.einsum("nij,nj->ni", pose[:, :3, :3], centres) + pose[:, :3, 3])
            properties = properties_of(tile.terrain, tile.squared, reference, limits)
            names = tuple(properties)
            away = np.abs(centres[:, None, :2] - map_from_ego[None, ::EVERY, :2, 3])
            weight = np.count_nonzero((away < GRID_HALF_M).all(axis=2), axis=1)
            judged = (codes > 0) & (tile.classes != TRAVERSABLE) & (weight > 0)
            columns = (np.column_stack(list(properties.values())), codes == 1, tile.classes == POTENTIAL, weight)
            frames_columns.append(tuple(column[judged] for column in columns))
    return JudgedVoxels(names, *map(np.concatenate, zip(*frames_columns, strict=True)))


def _vehicle_judge(truth: SimulationTruth) -> Judge:
    """Return a judge of a simulated world by the rules of the analytic ones."""
    cell_m, (rows, columns) = outside.CELL_M, truth.height_m.shape
    extent_m = np.array([columns - 1, rows - 1]) * truth.resolution_m
    shape = tuple((extent_m[::-1] / cell_m).astype(int) + 1)
    at = np.mgrid[: shape[0], : shape[1]] * (cell_m / truth.resolution_m)
    height = map_coordinates(truth.height_m, at, order=1)
    slope_deg, step_m = outside.plane_over(height, outside.FOOTPRINT_M)
    face_deg, _ = outside.plane_over(height, outside.FACE_M)
    tops = truth.obstacle_top_m[tuple(np.minimum(np.indices(shape).T, np.array(truth.obstacle_top_m.shape) - 1).T)]
    is_blocked = distance_transform_edt(tops <= height + outside.FOOT_M) * cell_m < outside.NEAR_M
    is_drivable = (slope_deg <= outside.DRIVABLE_DEG) & (step_m <= outside.STEP_M) & (face_deg <= outside.OBSTACLE_DEG)
    is_drivable &= ~is_blocked

    def judge(points: Array) -> NDArray[np.uint8]:
        index = np.rint((points[:, :2] - np.asarray(truth.origin_m)) / cell_m).astype(np.int64)
        j, i = np.clip(index, 0, np.array(shape)[::-1] - 1).T
        above = (points[:, 2] - truth.elevation_m(points[:, :2])) * np.cos(np.deg2rad(face_deg[i, j]))
        of_ground = np.where(is_drivable[i, j], outside.DRIVABLE, outside.GREY)
        of_things = np.where(truth.judge(points) == NOT_DRIVABLE, outside.OBSTACLE, outside.AIR)
        return np.where(np.abs(above) <= outside.BAND_M, of_ground, of_things).astype(np.uint8)

    return judge
