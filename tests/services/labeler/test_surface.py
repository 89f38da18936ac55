"""The surface of a tile against that of another solver: Open3D's screened Poisson, on an octree of the same cells."""

import os

import numpy as np
import pytest

from services.labeler.apart import apart
from stone.band import band_of
from stone.contour import zero_surface
from stone.patches import patches_of
from stone.screened import PoissonParameters, solve_field

W, SIZE_M = 0.2, 6.0
LOW = np.array([-0.9, -0.9, -2.9])


def height_m(xy):
    return 0.3 * np.sin(1.3 * xy[:, 0]) + 0.25 * np.cos(0.9 * xy[:, 1])


def sheet():
    """Points on rolling ground with 1 cm of noise, all seen from above."""
    rng = np.random.default_rng(0)
    xy = rng.uniform(0, SIZE_M, (6000, 2))
    return np.column_stack([xy, height_m(xy) + rng.normal(0, 0.01, len(xy))])


def octree_vertices(points, normals):
    """In a child: the solver must not be used before a fork, and warns past every log level of its two corner points,
    which are there to fix the octree's cube."""
    import open3d

    for stream in (1, 2):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream)
    corners = np.stack([LOW, LOW + 64 * W - 1e-6])
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(np.concatenate([points, corners])))
    cloud.normals = open3d.utility.Vector3dVector(np.concatenate([normals, np.zeros((2, 3))]))
    mesh, _ = open3d.geometry.TriangleMesh.create_from_point_cloud_poisson(
        cloud, width=W, scale=1.0, linear_fit=False, n_threads=1
    )
    return np.array(mesh.vertices)


def heights_on_lines(vertices):
    """Height by the vertical line of the lattice (i, j), away from the rim of the sheet."""
    index = vertices[:, :2] / W - 0.5
    is_on_line = (np.abs(index - np.round(index)) < 1e-4).all(axis=1)
    inside = ((vertices[:, :2] > 0.6) & (vertices[:, :2] < SIZE_M - 0.6)).all(axis=1)
    kept = is_on_line & inside & (np.abs(vertices[:, 2] - height_m(vertices)) < 0.2)
    return dict(zip(map(tuple, np.round(index[kept]).astype(int).tolist()), vertices[kept, 2].tolist(), strict=True))


@pytest.fixture(scope="module")
def heights():
    """By line: ours, the octree's, and the true ones."""
    points = sheet()
    patches, _ = patches_of(points, np.tile([0.0, 0.0, 1.0], (len(points), 1)), W, 20)
    band = band_of(patches.cells, W)
    ours = heights_on_lines(zero_surface(band, solve_field(patches, band, PoissonParameters())).vertices_map)
    theirs = heights_on_lines(apart(octree_vertices, patches.points_map, patches.normals))
    lines = sorted(ours.keys() & theirs.keys())
    assert len(lines) > 0.95 * ((SIZE_M - 1.2) / W) ** 2
    true = height_m((np.array(lines) + 0.5) * W)
    return np.array([ours[line] for line in lines]), np.array([theirs[line] for line in lines]), true


def test_an_octree_solver_finds_the_same_ground_within_a_centimetre(heights):
    ours, theirs, _ = heights
    assert np.percentile(np.abs(ours - theirs), 95) < 0.01


def test_the_ground_is_as_near_to_the_truth_as_an_octree_solver_brings_it(heights):
    ours, theirs, true = heights
    assert np.sqrt(np.mean((ours - true) ** 2)) < max(0.005, 1.1 * np.sqrt(np.mean((theirs - true) ** 2)))
    assert abs(np.mean(ours - true)) < 0.002
