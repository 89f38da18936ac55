"""The surface by Open3D's screened Poisson (Kazhdan & Hoppe, 2013), on an octree: the solver `octree`.

Its iso-value, its screening weight and its coarse levels follow from all points of a cube, so tiles differ a little
from an untiled run. The solver `lattice` (`stone.surface.screened_poisson`) has no such dependence and is the default.
This solver is the widely used one, with which the other is compared.

**Conventions.** The octree's root is the cube [low, low + cells · width). Two corner points without a normal set the
solver's bounding box and are then dropped by it, so cells lie on one lattice whatever the points. Cell corners are the
centres of label voxels, hence a vertex lies on a line between voxel centres, never on a voxel border.

One thread gives the same bits on every run; with more threads, results differ and Open3D crashes (Open3D #6828). A
process that forks others must not have used Open3D, or its children have only one core. Stages run in processes that do
not fork.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from stone.surface.mesh import Mesh
from stone.surface.neighbours import cells_of, plane_fits

# The solver rounds the extent up to a power of two of cells; the slack keeps an exact power from doubling.
SLACK_M = 1e-6
NEIGHBOURS = 20  # for the normal of a point
STREAMS = (1, 2)


def octree_surface(
    points_map: NDArray[np.float64], views_map: NDArray[np.float64], low: NDArray[np.float64], extent: tuple[int, float]
) -> Mesh:
    """Return the surface through points (N, 3) seen from directions (N, 3), over the square at `low` (2,).

    `extent` is (cells of the square, width of a cell in metres). The result is Open3D's, untrimmed.
    """
    width_m = extent[1]
    normals, has_plane = _normals(points_map, views_map, width_m)
    points_map, normals = points_map[has_plane], normals[has_plane]
    cells, bottom_m = _upright(points_map, extent)
    return reconstruct(points_map, normals, np.append(low, bottom_m), (cells, width_m))


def reconstruct(
    points_map: NDArray[np.float64], normals: NDArray[np.float64], low: NDArray[np.float64], extent: tuple[int, float]
) -> Mesh:
    """Return the surface through points (N, 3) with unit normals in the cube at `low` (3,).

    `extent` is (cells of a side, width of a cell in metres).
    """
    cells, width_m = extent
    corners = np.stack([low, low + cells * width_m - SLACK_M])
    points_map = np.concatenate([points_map, corners])
    return _solve(points_map, np.concatenate([normals, np.zeros((2, 3))]), width_m)


def _normals(
    points_map: NDArray[np.float64], views_map: NDArray[np.float64], width_m: float
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return unit normals (N, 3) on the side from which the points were seen, and a mask of existing normals."""
    fits = plane_fits(cells_of(points_map, width_m), NEIGHBOURS)
    towards = np.einsum("ni,ni->n", fits.normals, views_map)
    return np.where(towards[:, None] < 0, -fits.normals, fits.normals), np.isfinite(fits.mean_square_m2)


def _upright(points_map: NDArray[np.float64], extent: tuple[int, float]) -> tuple[int, float]:
    """Return the cells of a cube tall enough for the relief, and its bottom on the lattice of cell corners."""
    cells, width_m = extent
    z = points_map[:, 2]
    bottom_m = (np.floor(z.min() / width_m) - 2.5) * width_m
    while z.max() >= bottom_m + (cells - 2) * width_m:
        cells *= 2
    return cells, float(bottom_m)


def _solve(points_map: NDArray[np.float64], normals: NDArray[np.float64], width_m: float) -> Mesh:
    import open3d

    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points_map))
    cloud.normals = open3d.utility.Vector3dVector(normals)
    with _silent_streams():
        surface, _ = open3d.geometry.TriangleMesh.create_from_point_cloud_poisson(
            cloud, width=width_m, scale=1.0, linear_fit=False, n_threads=1
        )
    return Mesh(np.array(surface.vertices), np.array(surface.triangles, dtype=np.int32))


@contextmanager
def _silent_streams() -> Iterator[None]:
    """Silence the process's streams, to which the solver writes warnings regardless of the log level.

    It reports the two corner points as "bad data"; the warnings would corrupt progress bars and JSON.
    """
    kept, nowhere = [os.dup(stream) for stream in STREAMS], os.open(os.devnull, os.O_WRONLY)
    try:
        for stream in STREAMS:
            os.dup2(nowhere, stream)
        yield
    finally:
        for stream, descriptor in zip(STREAMS, kept, strict=True):
            os.dup2(descriptor, stream)
        for descriptor in (*kept, nowhere):
            os.close(descriptor)
