"""The surface of a tile against that of another solver: Open3D's screened Poisson, on an octree of the same cells."""

from dataclasses import replace

import numpy as np
import pytest

from services.labeler.local_run import LabelOptions, label
from services.labeler.map.octree import reconstruct
from services.labeler.parameters import parameters_for
from stone.surface.contour import band_of, zero_surface
from stone.surface.patches import patches_of
from stone.surface.screened_poisson import PoissonParameters, solve_field
from tests.services.labeler.worlds import RayCast, World, sequence_of

W, SIZE_M = 0.2, 6.0
LOW = np.array([-0.9, -0.9, -2.9])


def height_m(xy):
    return 0.3 * np.sin(1.3 * xy[:, 0]) + 0.25 * np.cos(0.9 * xy[:, 1])


def sheet():
    """Points on rolling ground with 1 cm of noise, all seen from above."""
    rng = np.random.default_rng(0)
    xy = rng.uniform(0, SIZE_M, (6000, 2))
    return np.column_stack([xy, height_m(xy) + rng.normal(0, 0.01, len(xy))])


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
    ours = heights_on_lines(zero_surface(band, solve_field(patches, band, PoissonParameters()).values).vertices_map)
    theirs = heights_on_lines(reconstruct(patches.points_map, patches.normals, LOW, (64, W)).vertices_map)
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


@pytest.mark.whole
def test_the_octree_solver_labels_a_driven_plane_without_a_hole(tmp_path):
    world, parameters, solver = World(frames=4), parameters_for("paper"), "octree"
    parameters = replace(parameters, surface=replace(parameters.surface, solver=solver))
    report = label(sequence_of(world), RayCast(world), tmp_path / "out", LabelOptions(parameters))
    assert report.as_record()["parameters"]["surface"]["solver"] == solver
    for path in (tmp_path / "out" / "gts").rglob("labels.npz"):
        with np.load(path) as arrays:
            columns = (arrays["semantics"][118:139, 118:139] > 0).any(axis=2)
        assert columns.all()
