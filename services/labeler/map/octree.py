"""The surface by Open3D's screened Poisson (Kazhdan & Hoppe, 2013), on an octree: the solver `octree`.

Its iso-value, its screening weight and its coarse levels follow from all points of a cube, so tiles differ a little
from what an untiled run would give; the solver `lattice` (`stone.surface.screened_poisson`) has no such dependence and
is the default. This one is what others use, and the measure of the other.

**Conventions.** The octree's root is the cube [low, low + cells · width): two corner points without a normal set the
solver's bounding box and are then dropped by it, so cells lie on one lattice whatever the points. Cell corners are
the centres of label voxels, hence a vertex lies on a line between voxel centres, never on a voxel border.

One thread: the same bits on every run; more threads differ between runs and crash upstream (Open3D #6828).
A process that forks others must not have used Open3D: it would leave them one core. Stages run in processes that
fork none.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from stone.surface.mesh import Mesh
from stone.surface.neighbours import cells_of, plane_fits

# The solver rounds the extent up to a power of two of cells; this much less keeps an exact power from doubling.
SLACK_M = 1e-6
NEIGHBOURS = 20  # of a point, for its normal
STREAMS = (1, 2)


def octree_surface(
    points_map: NDArray[np.float64], views_map: NDArray[np.float64], low: NDArray[np.float64], extent: tuple[int, float]
) -> Mesh:
    """The surface through points (N, 3) seen from the directions (N, 3), over the square at `low` (2,).

    `extent` is (cells of the square, width of a cell in metres). Open3D's answer as it is: untrimmed.
    """
    width_m = extent[1]
    normals, has_plane = _normals(points_map, views_map, width_m)
    points_map, normals = points_map[has_plane], normals[has_plane]
    cells, bottom_m = _upright(points_map, extent)
    return reconstruct(points_map, normals, np.append(low, bottom_m), (cells, width_m))


def reconstruct(
    points_map: NDArray[np.float64], normals: NDArray[np.float64], low: NDArray[np.float64], extent: tuple[int, float]
) -> Mesh:
    """The surface through points (N, 3) with unit normals in the cube at `low` (3,); `extent` = (cells, width m)."""
    cells, width_m = extent
    corners = np.stack([low, low + cells * width_m - SLACK_M])
    points_map = np.concatenate([points_map, corners])
    return _solved(points_map, np.concatenate([normals, np.zeros((2, 3))]), width_m)


def _normals(
    points_map: NDArray[np.float64], views_map: NDArray[np.float64], width_m: float
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Unit normals (N, 3) on the side the points were seen from, and which of them there are."""
    fits = plane_fits(cells_of(points_map, width_m), NEIGHBOURS)
    towards = np.einsum("ni,ni->n", fits.normals, views_map)
    return np.where(towards[:, None] < 0, -fits.normals, fits.normals), np.isfinite(fits.mean_square_m2)


def _upright(points_map: NDArray[np.float64], extent: tuple[int, float]) -> tuple[int, float]:
    """The cells of a cube tall enough for the relief, and its bottom on the lattice of cell corners."""
    cells, width_m = extent
    z = points_map[:, 2]
    bottom_m = (np.floor(z.min() / width_m) - 2.5) * width_m
    while z.max() >= bottom_m + (cells - 2) * width_m:
        cells *= 2
    return cells, float(bottom_m)


def _solved(points_map: NDArray[np.float64], normals: NDArray[np.float64], width_m: float) -> Mesh:
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
    """The solver writes warnings of its own past every log level (the two corner points are "bad data" to it, which
    is their purpose) straight to the process's streams, where they would spoil progress bars and JSON."""
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
