"""One map, several grids: each is the same labels resampled by the definition, whatever the grid."""

import json
from dataclasses import replace

import numpy as np
import pytest

from services.labeler.exports.source import read_report
from services.labeler.local_run import LabelOptions, label
from services.labeler.parameters import chosen_parameters
from stone.labels.voxels import VOXEL_M
from stone.sensors.calibration import Box
from stone_base.label_grid import OCC3D, PAPER, RELEASE, LabelGrid
from stone_files.grid_file import read_grid_file
from tests.services.labeler.worlds import RayCast, World, sequence_of

WORLD = World(grade=(0.06, 0.02), boxes=(Box((1.5, 2.0, 0.0), (2.7, 3.2, 1.4)),))
# The same space in voxels of the map's size and twice as large.
FINE = LabelGrid("fine", (-24.0, -24.0, -1.0), VOXEL_M, (240, 240, 32))
COARSE = LabelGrid("coarse", (-24.0, -24.0, -1.0), 2 * VOXEL_M, (120, 120, 16), unknown=255)
GRIDS = (PAPER, RELEASE, OCC3D, FINE, COARSE)
KEYS = ("semantics", "mask_lidar", "mask_camera")


@pytest.fixture(scope="module", params=["paper", "field"])
def made(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("grids") / "out"
    parameters = replace(chosen_parameters(request.param, {}, GRIDS), confidence=request.param == "field")
    label(sequence_of(WORLD), RayCast(WORLD), folder, LabelOptions(parameters, workers=2))
    return folder


def frames_of(folder, grid, keys=KEYS):
    """Each frame's arrays, in the order of time."""
    root = folder if grid == GRIDS[0] else folder / "grids" / grid.name
    for token in sequence_of(WORLD).frames.tokens:
        with np.load(root / "gts" / "small" / token / "labels.npz") as arrays:
            yield tuple(arrays[key] for key in keys)


def resampled(classes, n):
    """By the definition: of each cube the class of most of what is occupied, the highest of equals."""
    x, y, z = (side // n for side in classes.shape)
    cubes = classes.reshape(x, n, y, n, z, n).transpose(0, 2, 4, 1, 3, 5).reshape(x, y, z, n**3)
    counts = np.stack([(cubes == kind).sum(axis=-1) for kind in (3, 2, 1)])
    return np.where(counts.any(axis=0), 3 - counts.argmax(axis=0), 0)


def test_larger_voxels_are_the_labels_of_smaller_ones_resampled(made):
    for (fine, fine_seen, _), (coarse, seen, _) in zip(frames_of(made, FINE), frames_of(made, COARSE), strict=True):
        assert (coarse == resampled(fine, 2)).all()
        assert (seen == (resampled(fine_seen, 2) > 0)).all()
        assert len(np.unique(coarse)) >= 3


def test_every_grid_has_its_shape_and_says_its_name(made):
    for grid in GRIDS:
        for arrays in frames_of(made, grid):
            assert {array.shape for array in arrays} == {grid.shape}
        root = made if grid == PAPER else made / "grids" / grid.name
        assert read_grid_file(root / "grid.json") == grid
        report = json.loads((root / "report.json").read_text())
        assert report["grid"] == grid.as_record()
        assert sum(report["class_share_of_occupied"].values()) == pytest.approx(1, abs=1e-5)
        read_report(root)


def test_grids_of_one_geometry_have_the_same_labels(made):
    """The release's and Occ3D's differ in their files' numbers alone, which exports write."""
    for ours, theirs in zip(frames_of(made, RELEASE), frames_of(made, OCC3D), strict=True):
        assert all((a == b).all() for a, b in zip(ours, theirs, strict=True))


def test_grids_agree_where_they_overlap(made):
    """At nine of ten places where one has a surface, so has the other."""
    points = np.stack(np.meshgrid(np.arange(-20, 20, 0.4), np.arange(-20, 20, 0.4), np.arange(-0.8, 2, 0.4)), axis=-1)
    for (paper, *_), (release, *_) in zip(frames_of(made, PAPER), frames_of(made, RELEASE), strict=True):
        here, there = (_at(points, *pair) for pair in ((paper, PAPER), (release, RELEASE)))
        both = (here > 0) & (there > 0)
        assert both.sum() > 0.9 * (here > 0).sum() > 500
        assert (here == there)[both].mean() > 0.95


def _at(points, classes, grid):
    return classes[tuple(np.moveaxis(np.floor((points - grid.min_m) / grid.voxel_m).astype(int), -1, 0))]


def test_masks_agree_with_labels_at_every_grid(made):
    for grid in GRIDS:
        for semantics, lidar, camera in frames_of(made, grid):
            assert (lidar[semantics > 0] == 1).all()
            assert (lidar[camera > 0] == 1).all()
            assert 0.001 < lidar.mean() < 0.9


def test_confidence_of_a_larger_voxel_lies_between_those_of_its_map_voxels(made):
    if json.loads((made / "report.json").read_text())["parameters"]["profile"] != "field":
        pytest.skip("the profile has no confidence")
    keys = ("semantics", "confidence", "distance_squared")
    for (fine, sure, far), (coarse, ours, ours_far) in zip(
        frames_of(made, FINE, keys), frames_of(made, COARSE, keys), strict=True
    ):
        for index in np.argwhere(coarse > 0)[::97].tolist():
            cube = tuple(slice(2 * at, 2 * at + 2) for at in index)
            of_class = fine[cube] == coarse[tuple(index)]
            assert ours[tuple(index)] == round(float(sure[cube][of_class].mean()))
            assert ours_far[tuple(index)] == pytest.approx(far[cube][of_class].astype(float).mean(), rel=2e-3)
        assert (ours_far[coarse == 0] == -1).all()
        assert (ours[coarse == 0] == 0).all()
