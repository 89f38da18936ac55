"""Fusing by parts: the files of all parts together are the map of the run, however it was divided or driven."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from services.labeler.map.fuse import fuse
from services.labeler.parameters import LabelParameters, TilingParameters
from services.labeler.run import LabelRun, parts_of
from services.labeler.scratch import load_observed, load_points, tile_named
from stone.labels.observed_voxels import union
from stone.sensors.calibration import Box
from stone.sensors.sequence import Frames, Sweep
from stone.surface.pointmap import merge
from tests.observed_voxels import voxel_keys
from tests.services.labeler.worlds import RayCast, World, sequence_of

WORLD = World(
    grade=(0.04, -0.02),
    boxes=(Box((1.0, 2.0, 0.0), (2.0, 3.0, 1.5)),),
    map_from_world=(1.0, 0, 0, 0, 0.3, -0.7, 0),  # over the corner of four tiles
    frames=10,
    step_m=1.1,
)
EVERYWHERE = (np.full(2, -1000.0), np.full(2, 1000.0))


def run_in(folder, frames_per_part, sequence=None, sweeps=None):
    parameters = LabelParameters(tiling=TilingParameters(frames_per_part=frames_per_part))
    return LabelRun(sequence or sequence_of(WORLD), sweeps or RayCast(WORLD), parameters, folder)


def fused(run):
    """The whole point map, what was observed, and how many points were fused."""
    points = sum(fuse(run, part) for part in reversed(parts_of(run)))
    tiles = [tile_named(folder.name) for folder in (run.scratch / "fused").iterdir()]
    maps = [part for tile in tiles for part in load_points(run, tile, *EVERYWHERE)]
    return merge(maps), union([load_observed(run, tile) for tile in tiles]), points, len(tiles)


@pytest.mark.parametrize("frames_per_part", [1, 3, 7])
def test_any_division_into_parts_gives_the_same_bits(tmp_path, frames_per_part):
    whole, whole_observed, points, tiles = fused(run_in(tmp_path / "whole", 10))
    parts, parts_observed, added, _ = fused(run_in(tmp_path / "parts", frames_per_part))
    assert tiles == 4
    assert points == added == whole.counts().sum()
    assert parts.keys.tobytes() == whole.keys.tobytes()
    assert parts.moments.tobytes() == whole.moments.tobytes()
    assert parts_observed.keys.tobytes() == whole_observed.keys.tobytes()
    assert parts_observed.words.tobytes() == whole_observed.words.tobytes()


@dataclass(frozen=True)
class Again:
    """The same drive a second time, begun where the first one ended."""

    frames: int

    def sweep(self, index: int) -> Sweep:
        return RayCast(WORLD).sweep(index % self.frames)


def test_a_place_driven_twice_has_the_voxels_of_one_pass_and_the_points_of_both(tmp_path):
    once = sequence_of(WORLD)
    poses = once.frames.map_from_ego
    twice = np.concatenate([np.arange(len(poses))] * 2)
    stamps_ns = once.frames.stamps_ns[twice] + np.repeat([0, 3_600_000_000_000], len(poses))
    frames = Frames(stamps_ns, tuple(f"{row:032x}" for row in range(len(twice))), poses[twice])
    one, one_observed, points, _ = fused(run_in(tmp_path / "once", 4))
    both, both_observed, added, _ = fused(
        run_in(tmp_path / "twice", 4, replace(once, frames=frames), Again(len(poses)))
    )
    assert added == 2 * points
    assert both.keys.tobytes() == one.keys.tobytes()
    assert (both.moments == 2 * one.moments).all()
    assert voxel_keys(both_observed).tobytes() == voxel_keys(one_observed).tobytes()
