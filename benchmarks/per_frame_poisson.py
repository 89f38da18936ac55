"""A baseline for dense labels: the surface of every frame reconstructed separately.

After SurroundOcc (Wei et al., ICCV 2023, `generate_occupancy_nuscenes`): the whole aggregated cloud is moved into the
frame, cropped and given normals towards the sensor by 20 neighbours. It is reconstructed by Poisson at depth 10,
stripped of the tenth of its vertices with the lowest density, and voxelised. It is our own implementation, one thread,
without the labels of other classes, which the original finds by nearest neighbour on a GPU.

**Conventions.** Seconds are processor time of this process and its awaited children.
"""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from services.ingest.sequence import open_sequence
from services.labeler.map.fuse import fuse
from services.labeler.parameters import parameters_for
from services.labeler.run import LabelRun
from services.labeler.scratch import load_points, tile_named
from services.labeler.tile_plan import plan_of
from services.runtime.sandbox import SandboxLimits, sandboxed
from services.runtime.telemetry.process_usage import used_cpu_s
from stone.geometry.se3 import SE3
from stone.labels.voxels import VOXEL_M
from stone.surface.pointmap import merge
from stone_base.label_grid import PAPER

NEIGHBOURS, DEPTH, LEAST_DENSE = 20, 10, 0.1
LIMITS = SandboxLimits(memory_bytes=32 * 2**30, cpu_s=3600, imports=("open3d",))
EVERYWHERE_M = 1e5  # the map's lattice ends there


@dataclass(frozen=True)
class PerFrame:
    """The cost of each of the chosen frames, and the resulting voxels."""

    cpu_s: tuple[float, ...]
    voxels: tuple[int, ...]


def per_frame_poisson(bag: Path, calibration: Path, frames: int, folder: Path) -> PerFrame:
    """Reconstruct `frames` frames, spread evenly over the run, one by one; aggregation is not counted."""
    sequence, sweeps = open_sequence(bag, calibration, bag.stem)
    run = LabelRun(sequence, sweeps, parameters_for("paper"), folder)
    for part in plan_of(run).parts:
        fuse(run, part)
    cloud = _aggregated(run)
    chosen = np.linspace(0, len(sequence.frames) - 1, frames).round().astype(int)
    taken, voxels = list[float](), list[int]()
    for index in chosen:
        before = used_cpu_s()
        pose = sequence.frames.map_from_ego[int(index)]
        voxels.append(int(sandboxed(partial(_frame_voxels, cloud, pose, run.sensor_ego), LIMITS)))
        taken.append(used_cpu_s() - before)
    return PerFrame(tuple(taken), tuple(voxels))


def _aggregated(run: LabelRun) -> NDArray[np.float64]:
    """Return all points of the run in the map frame, one per voxel of 0.1 m."""
    everywhere = (np.full(2, -EVERYWHERE_M), np.full(2, EVERYWHERE_M))
    tiles = [tile_named(folder.name) for folder in sorted((run.scratch / "fused").iterdir())]
    return merge([part for tile in tiles for part in load_points(run, tile, *everywhere)]).centroids_map()


def _frame_voxels(cloud_map: NDArray[np.float64], map_from_ego: SE3, sensor_ego: NDArray[np.float64]) -> bytes:
    """Return the number of voxels on the surface of this frame; in a child, as Open3D must not run before a fork."""
    import open3d

    points = map_from_ego.inverse() @ cloud_map
    points = points[((points >= PAPER.min_m) & (points < PAPER.max_m)).all(axis=1)]
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    cloud.estimate_normals(open3d.geometry.KDTreeSearchParamKNN(knn=NEIGHBOURS))
    cloud.orient_normals_towards_camera_location(sensor_ego)
    mesh, density = open3d.geometry.TriangleMesh.create_from_point_cloud_poisson(cloud, depth=DEPTH, n_threads=1)
    mesh.remove_vertices_by_mask(np.asarray(density) < np.quantile(np.asarray(density), LEAST_DENSE))
    voxels = np.unique(np.floor(np.asarray(mesh.vertices) / VOXEL_M).astype(np.int64), axis=0)
    return str(len(voxels)).encode()
