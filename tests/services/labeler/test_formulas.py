"""Profile `paper` is Eq. 1–6 and nothing else: voxel for voxel what plain loops make of the same mesh."""

import io
from dataclasses import dataclass, replace

import numpy as np
import pytest

from services.labeler.frames import labelled_frames, labelled_tile
from services.labeler.map import surface as surface_stage
from services.labeler.map.fuse import fuse
from services.labeler.map.surface import surface
from services.labeler.parameters import parameters_for
from services.labeler.results import reference_from
from services.labeler.run import LabelRun, Tile
from stone.geometry.lattice import indices_of
from stone.sensors.calibration import Box
from stone.surface.mesh import Mesh
from stone_base.label_grid import PAPER
from tests.services.labeler.straight_line import Constants, classes_by_voxel, vertex_normals
from tests.services.labeler.worlds import RayCast, World, sequence_of

# Level and along the lattice, so that a frame's voxels are the map's; on one tile; low things to climb, and a high one.
LEVEL = World(
    boxes=(
        Box((1.5, 2.0, 0.0), (2.7, 3.2, 1.4)),
        Box((-3.0, -2.6, 0.0), (-1.2, -1.2, 0.12)),
        Box((0.4, -0.3, 0.0), (1.6, 0.4, 0.06)),
        Box((3.0, -3.0, 0.0), (4.4, -1.9, 0.3)),
    ),
    reach_m=4.5,
    frames=8,
)
TILTED = replace(LEVEL, grade=(0.09, -0.04), map_from_world=(np.cos(0.2), 0, 0, np.sin(0.2), 24.07, 23.9, 1.3))


@dataclass(frozen=True, eq=False)
class Labelled:
    """What the labeler made of a world, and the mesh it made it of."""

    run: LabelRun
    whole: Mesh
    trimmed: Mesh
    classes: dict
    frames: list

    def oracle(self, constants=Constants()):  # noqa: B008  frozen
        kept = {tuple(vertex) for vertex in self.trimmed.vertices_map}
        rows = [row for row, vertex in enumerate(self.whole.vertices_map) if tuple(vertex) in kept]
        normals = vertex_normals(self.whole.vertices_map, self.whole.triangles)
        matrices = self.run.sequence.frames.map_from_ego.as_matrix()
        return classes_by_voxel(self.whole.vertices_map[rows], normals[rows], matrices, constants)


def labelled(world, folder):
    """Every stage of the labeler, with the mesh looked at on its way."""
    seen = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(surface_stage, "vertex_normals", watched(surface_stage.vertex_normals, seen, "whole"))
        patch.setattr(surface_stage, "terrain_features", watched(surface_stage.terrain_features, seen, "trimmed"))
        run = LabelRun(sequence_of(world), RayCast(world), parameters_for("paper"), folder)
        part = (0, world.frames)
        fuse(run, part)
        reference = reference_from(run, [surface(run, Tile(0, 0))])
    found = labelled_tile(run, Tile(0, 0), reference)
    voxels = dict(zip(map(tuple, indices_of(found.terrain.keys).tolist()), found.classes.tolist(), strict=True))
    return Labelled(run, seen["whole"], seen["trimmed"], voxels, list(labelled_frames(run, part, reference)))


def watched(function, seen, name):
    """The function, whose first argument is kept: the mesh before or after what no point is near was trimmed."""

    def call(mesh, *arguments):
        seen[name] = mesh
        return function(mesh, *arguments)

    return call


@pytest.fixture(scope="module")
def level(tmp_path_factory):
    return labelled(LEVEL, tmp_path_factory.mktemp("level"))


@pytest.fixture(scope="module")
def tilted(tmp_path_factory):
    return labelled(TILTED, tmp_path_factory.mktemp("tilted"))


def test_every_voxel_of_the_map_has_the_class_that_the_equations_give_it(tilted):
    assert differing(tilted.classes, tilted.oracle()) == {}
    assert (np.bincount(list(tilted.classes.values()), minlength=4)[1:] > 50).all()


def test_the_grid_of_every_frame_holds_those_voxels_and_no_others(level):
    expected = level.oracle()
    assert differing(level.classes, expected) == {}
    poses = level.run.sequence.frames.map_from_ego
    for index, frame in enumerate(level.frames):
        corner = np.round((poses[index].translation_m + PAPER.min_m) / 0.2).astype(int)
        grid = np.zeros(PAPER.shape, np.uint8)
        for voxel, kind in expected.items():
            at = np.array(voxel) - corner
            if (at >= 0).all() and (at < PAPER.shape).all():
                grid[tuple(at)] = kind
        np.testing.assert_array_equal(semantics(frame), grid)


def differing(a, b):
    """voxel → its class in either, where these differ."""
    return {voxel: (a.get(voxel), b.get(voxel)) for voxel in a.keys() | b.keys() if a.get(voxel) != b.get(voxel)}


def semantics(frame):
    with np.load(io.BytesIO(frame.payload), allow_pickle=False) as arrays:
        return arrays["semantics"]


MUTATIONS = (Constants(k=19), Constants(alpha=0.06), Constants(band_m=0.05), Constants(size_m=(1.06, 1.05)))


@pytest.mark.whole
@pytest.mark.parametrize("other", MUTATIONS, ids=["k", "alpha", "band", "width"])
def test_another_constant_gives_another_map(tilted, other):
    assert differing(tilted.classes, tilted.oracle(other))
