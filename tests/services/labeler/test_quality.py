"""What labels must never show: somebody who walked by, ground lost under a crown, surface nobody saw, a floor twice."""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest

from services.labeler.frames import labelled_tile
from services.labeler.map.fuse import fuse
from services.labeler.map.surface import surface
from services.labeler.parameters import parameters_for
from services.labeler.results import reference_from
from services.labeler.run import LabelRun, Tile
from stone.geometry.lattice import centres_of
from stone.geometry.se3 import SE3
from stone.sensors.calibration import Box
from stone.sensors.sequence import Sweep
from stone.surface.range_image import DynamicParameters
from tests.services.labeler.worlds import EGO_FROM_LIDAR, RayCast, World, sequence_of

# Bumpy enough for a reference: a kerb lies across the way.
KERB = Box((-0.6, -0.5, 0.0), (0.6, 0.5, 0.05))
WORLD = World(boxes=(KERB,), frames=30, step_m=0.1, reach_m=6.0, spacing_m=0.16)

SLOW = replace(WORLD, frames=50, step_m=0.05, spacing_m=0.06)


@dataclass(frozen=True, eq=False)
class Labelled:
    """The voxels of the map: centres (K, 3) in the world, classes (K,)."""

    centres: np.ndarray
    classes: np.ndarray

    def inside(self, low, high):
        """The classes of those in the box [low, high)."""
        return self.classes[((self.centres >= low) & (self.centres < high)).all(axis=1)]


def labelled(folder, sweeps, sequence=None, parameters=None):
    """Fuse, reconstruct and classify a world that fits one tile."""
    sequence = sequence or sequence_of(WORLD)
    run = LabelRun(sequence, sweeps, parameters or parameters_for("paper"), folder)
    fuse(run, (0, len(sequence.frames)))
    reference = reference_from(run, [surface(run, Tile(0, 0))])
    found = labelled_tile(run, Tile(0, 0), reference)
    return Labelled(WORLD.placed().inverse() @ centres_of(found.terrain.keys, 0.2), found.classes)


@dataclass(frozen=True)
class Crossing:
    """Somebody walks across in front of the robot, 0.12 m a frame, and on; behind is a wall that rays meet then."""

    def box(self, index):
        y = -2.4 + 0.12 * index
        return Box((2.6, y - 0.25, 0.0), (3.1, y + 0.25, 1.7))

    def sweep(self, index):
        wall = tuple(Box((6.0, y, 0.0), (6.3, y + 1.0, 2.6)) for y in range(-7, 7))
        return RayCast(replace(SLOW, boxes=(KERB, self.box(index), *wall))).sweep(index)


@pytest.mark.release
def test_somebody_who_walks_across_leaves_no_label(tmp_path):
    """Catches alone labels of what moved, through all stages."""
    blind = replace(parameters_for("paper"), dynamic=DynamicParameters(max_range_m=0.0))
    trail = ((2.4, -2.8, 0.3), (3.3, 2.3, 1.8))
    assert len(labelled(tmp_path / "blind", Crossing(), sequence_of(SLOW), blind).inside(*trail)) > 100
    seen = labelled(tmp_path / "seen", Crossing(), sequence_of(SLOW))
    assert len(seen.inside(*trail)) == 0
    ground = seen.inside((2.4, -2.8, -0.2), (3.3, 2.3, 0.2))
    assert len(ground) >= 100
    assert (ground == 2).mean() > 0.7  # soles and shins are too near the ground for any ray to pass behind them


@pytest.mark.parametrize("profile", ["paper", "local"])
def test_ground_under_a_crown_stays_ground_and_the_crown_is_not(profile, tmp_path):
    crown = Box((1.4, 1.0, 2.0), (3.4, 3.0, 2.7))
    world = replace(WORLD, boxes=(KERB, crown))
    made = labelled(tmp_path, RayCast(world), parameters=parameters_for(profile))
    beneath = made.inside((1.4, 1.0, -0.2), (3.4, 3.0, 0.2))
    assert len(beneath) >= 100
    assert set(beneath.tolist()) == {2}
    above = made.inside((1.2, 0.8, 1.6), (3.6, 3.2, 3.0))
    assert len(above) > 50
    assert set(above.tolist()) == {3}
    assert len(made.inside((1.6, 1.2, 0.4), (3.2, 2.8, 1.6))) == 0


@dataclass(frozen=True)
class Gap:
    """A strip across the way, 1.4 m wide, from which nothing comes back, as from a pond."""

    def sweep(self, index):
        sweep = RayCast(WORLD).sweep(index)
        world_from_lidar = WORLD.world_from_ego(index) @ EGO_FROM_LIDAR
        x = (world_from_lidar @ sweep.points_lidar.astype(np.float64))[:, 0]
        return Sweep(sweep.stamp_ns, sweep.points_lidar[(x < 2.0) | (x > 3.4)])


def test_surface_that_nobody_saw_is_not_labelled(tmp_path):
    made = labelled(tmp_path, Gap())
    trim_m, voxel_m = parameters_for("paper").surface.trim_m, 0.2
    edge_m = trim_m + voxel_m / 2
    assert len(made.inside((2.0 + edge_m, -5.0, -2.0), (3.4 - edge_m, 5.0, 2.0))) == 0
    assert len(made.inside((1.0, -2.0, -0.2), (2.0, 2.0, 0.2))) >= 100
    assert len(made.inside((3.4, -2.0, -0.2), (4.4, 2.0, 0.2))) >= 100


@pytest.mark.parametrize("offset_m", [0.02, -0.02])
def test_two_passes_of_one_place_two_centimetres_apart_give_one_sheet(offset_m, tmp_path):
    sequence = sequence_of(WORLD)
    poses = sequence.frames.map_from_ego.wxyz_xyz.copy()
    poses[:, 6] += 0.05  # in the middle of a voxel's half, so that two centimetres do not change the voxel
    once = moved(sequence, poses)
    again = poses.copy()
    again[1::2, 6] += offset_m
    first = labelled(tmp_path / "once", RayCast(WORLD), once)
    both = labelled(tmp_path / "both", RayCast(WORLD), moved(sequence, again))
    assert layers(first) == layers(both) == {1}
    assert len(both.classes) < 1.02 * len(first.classes)


def moved(sequence, poses):
    return replace(sequence, frames=replace(sequence.frames, map_from_ego=SE3(poses)))


def layers(made):
    """How many voxels lie above each other in the columns well inside what was seen, away from the kerb's sides."""
    x, y = made.centres[:, 0], made.centres[:, 1]
    inner = (np.hypot(x, y) < 4.5) & ((np.abs(x) > 1.0) | (np.abs(y) > 0.9))
    _, counts = np.unique(np.round(made.centres[inner, :2], 3), axis=0, return_counts=True)
    return set(counts.tolist())


FAST = replace(WORLD, frames=8, step_m=0.6)


class InTheWay:
    """Somebody stands on the way for the first sweeps and is gone when the robot comes; one sweep a second."""

    def sweep(self, index):
        boxes = (KERB, Box((1.0, -0.25, 0.0), (1.5, 0.25, 1.1))) if index < 2 else (KERB,)
        return RayCast(replace(FAST, boxes=boxes)).sweep(index)


def test_nobody_is_left_standing_where_the_robot_drove_at_one_sweep_a_second(tmp_path):
    sequence = sequence_of(FAST)
    stamps_ns = sequence.frames.stamps_ns[0] + np.arange(8) * 1_000_000_000
    slow = replace(sequence, frames=replace(sequence.frames, stamps_ns=stamps_ns))
    blind = replace(parameters_for("paper"), dynamic=DynamicParameters(max_range_m=0.0), body_clearance_m=math.inf)
    body = ((0.8, -0.4, 0.4), (1.7, 0.4, 1.1))
    assert len(labelled(tmp_path / "blind", InTheWay(), slow, blind).inside(*body)) > 10
    assert len(labelled(tmp_path / "seen", InTheWay(), slow).inside(*body)) == 0
