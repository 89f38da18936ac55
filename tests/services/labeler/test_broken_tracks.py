"""Where a track breaks, each part is labelled as if it had been driven alone, and nothing between is driven."""

from dataclasses import replace

import numpy as np
import pytest

from services.labeler.local_run import LabelOptions, label
from services.labeler.parameters import LabelParameters, TilingParameters
from stone.geometry.se3 import SE3
from stone.labels.voxels import VOXEL_M
from stone.sensors.calibration import Box, Footprint
from stone.sensors.ground_plane import BAND_M
from stone_base.label_grid import PAPER
from tests.services.labeler.worlds import RayCast, World, sequence_of

WORLD = World(grade=(0.06, 0.02), boxes=(Box((1.5, 2.0, 0.0), (2.7, 3.2, 1.4)),), frames=16)
BREAK = 10  # rays are followed, and images taken, of every fifth frame
# Onto the place of the first half, where a fused map would be doubled.
JUMP_M = np.array([-3.0, 0.5, 0.8])
PARAMETERS = LabelParameters(tiling=TilingParameters(frames_per_part=4))


class Shifted:
    """The sweeps of the frames from `begin` on."""

    def __init__(self, begin):
        self.begin = begin

    def sweep(self, index):
        return RayCast(WORLD).sweep(index + self.begin)


def jumped():
    sequence = sequence_of(WORLD)
    poses = sequence.frames.map_from_ego.wxyz_xyz.copy()
    poses[BREAK:, 4:] += JUMP_M
    return replace(sequence, frames=replace(sequence.frames, map_from_ego=SE3(poses)))


def part(sequence, begin, end):
    frames = sequence.frames
    rows = slice(begin, end)
    return replace(
        sequence,
        frames=replace(
            frames, stamps_ns=frames.stamps_ns[rows], tokens=frames.tokens[rows], map_from_ego=frames.map_from_ego[rows]
        ),
    )


def grids(folder, tokens):
    return [np.load(folder / "gts" / "small" / token / "labels.npz") for token in tokens]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The broken run, and both of its halves alone."""
    folder, whole = tmp_path_factory.mktemp("broken"), jumped()
    options = LabelOptions(parameters=PARAMETERS)
    report = label(whole, RayCast(WORLD), folder / "whole", options)
    alone = label(part(whole, 0, BREAK), RayCast(WORLD), folder / "first", options)
    label(part(whole, BREAK, 16), Shifted(BREAK), folder / "second", options)
    return folder, whole.frames, (report, alone)


@pytest.mark.whole
def test_each_part_is_mapped_as_if_it_were_alone(made):
    folder, frames, _ = made
    alone = [*grids(folder / "first", frames.tokens[:BREAK]), *grids(folder / "second", frames.tokens[BREAK:])]
    for ours, theirs in zip(grids(folder / "whole", frames.tokens), alone, strict=True):
        assert np.array_equal(ours["semantics"] > 0, theirs["semantics"] > 0)
        assert np.array_equal(ours["semantics"] == 1, theirs["semantics"] == 1)
        assert np.array_equal(ours["mask_lidar"], theirs["mask_lidar"])


@pytest.mark.whole
def test_nothing_is_driven_on_beyond_the_footprint_of_a_pose(made):
    folder, frames, _ = made
    footprint, poses = Footprint(), frames.map_from_ego
    reach_m = np.hypot(footprint.length_m, footprint.width_m) / 2 + BAND_M + 0.2  # the poses are 0.4 m apart
    for index, grid in enumerate(grids(folder / "whole", frames.tokens)):
        rows = slice(0, BREAK) if index < BREAK else slice(BREAK, None)
        driven = poses[index] @ (np.argwhere(grid["semantics"] == 1) * VOXEL_M + PAPER.min_m + VOXEL_M / 2)
        gaps_m = np.linalg.norm(driven[:, None] - poses.translation_m[rows], axis=2).min(axis=1)
        assert len(driven) > 20
        assert gaps_m.max() < reach_m + VOXEL_M


@pytest.mark.whole
def test_a_jump_in_height_is_no_relief(made):
    """Both halves climb the same hill, and the second was put 0.8 m higher."""
    *_, (report, alone) = made
    sigmas_m = [np.sqrt(each.reference.covariance[0, 0]) for each in (report, alone)]
    assert sigmas_m[0] == pytest.approx(sigmas_m[1], abs=0.02)
