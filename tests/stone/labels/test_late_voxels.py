"""Late voxels against the brick of each voxel's centre, looked up one by one."""

import numpy as np
import pytest

from stone.geometry.lattice import keys_from_indices
from stone.geometry.se3 import SE3
from stone.labels.columns import Columns, gathered, spread_out
from stone.labels.grid import frame_bounds, window_of
from stone.labels.late_voxels import first_seen, late_columns
from stone.labels.observed_voxels import BRICK, NOTHING, CarveParameters, Carver, Observed, union
from stone.labels.voxels import VOXEL_M
from stone_base.label_grid import PAPER, LabelGrid

COARSE = LabelGrid("coarse", PAPER.min_m, 0.4, (128, 128, 16))
LATER = 20
POSES = {
    "level": SE3(np.array([1.0, 0, 0, 0, 0.03, -0.07, 0.01])),
    "turned": SE3.from_parts(np.array([0.9, 0.02, -0.01, 0.4]), np.array([-313.0, 121.3, 4.2])),
    "steep": SE3.from_parts(np.array([0.8, 0.3, -0.35, 0.3]), np.array([13.0, -21.3, 4.2])),
}


@pytest.mark.parametrize("pose", POSES)
def test_a_voxel_is_late_if_its_brick_is_seen_only_later(pose):
    rng, bounds = np.random.default_rng(3), frame_bounds(POSES[pose])
    low, high = bounds[0] // BRICK - 1, bounds[1] // BRICK + 2
    # a far corner of the map and scattered bricks are seen later; a third of the bricks is never seen
    places = np.stack(np.meshgrid(*map(np.arange, low, high), indexing="ij"), axis=-1).reshape(-1, 3)
    places = places[rng.random(len(places)) < 0.67]
    is_later = (places[:, 0] - low[0] > 50) & (places[:, 1] > low[1] + 30) | (rng.random(len(places)) < 0.01)
    since = np.where(is_later, LATER, LATER - 1).astype(np.int32)
    order = np.argsort(keys_from_indices(places))
    places, since = places[order], since[order]
    observed = Observed(keys_from_indices(places), np.full(len(places), 2**64 - 1, np.uint64), since)
    window = window_of(np.zeros(0, np.int64), np.zeros(0, np.uint8), NOTHING, bounds)
    seen, classes = rng.random(PAPER.shape) < 0.4, rng.integers(0, 4, PAPER.shape) * (rng.random(PAPER.shape) < 0.1)
    fine = Columns(gathered(classes & 1), gathered(classes & 2), gathered(seen))

    first = first_seen(observed, window), LATER
    late = spread_out(late_columns(fine, window, POSES[pose], first, PAPER)) > 0
    coarse = spread_out(late_columns(fine, window, POSES[pose], first, COARSE), height=16) > 0

    index = np.stack(np.meshgrid(*map(np.arange, PAPER.shape), indexing="ij"), axis=-1)
    at = np.floor(POSES[pose] @ ((index + 0.5) * VOXEL_M + np.array(PAPER.min_m)) / VOXEL_M).astype(np.int64) // BRICK
    frames = np.full(tuple(high - low), -1)
    frames[tuple((places - low).T)] = since
    whole = seen | (classes > 0)
    expected = (frames[tuple(np.moveaxis(at - low, -1, 0))] >= LATER) & whole
    assert 10_000 < expected.sum() < 0.5 * whole.sum()
    assert (late != expected).sum() <= 1e-4 * expected.sum()  # centres at the border of two bricks
    cubes = (128, 2, 128, 2, 16, 2)
    early = (whole & ~late).reshape(cubes).any(axis=(1, 3, 5))
    assert (coarse == whole.reshape(cubes).any(axis=(1, 3, 5)) & ~early).all()


def test_a_brick_is_seen_since_the_first_sweep_that_touched_it():
    def carved(*frames):
        carver = Carver(CarveParameters(), slots=16)
        for frame in frames:
            ends = np.array([[3.0 + frame, 0.1 * frame, 0.0]], np.float32)
            carver.carve(ends, SE3.identity(), np.array([0.0, 0, 0]), frame)
        return carver.finish()

    alone, whole = [carved(frame) for frame in range(8)], carved(*range(8))
    expected = {key: frame for frame in reversed(range(8)) for key in alone[frame].keys.tolist()}
    assert dict(zip(whole.keys.tolist(), whole.since.tolist(), strict=True)) == expected
    assert len(set(expected.values())) == 8
    joined = union([carved(*range(4, 8)), carved(*range(4))])
    assert joined.since.tolist() == whole.since.tolist()
