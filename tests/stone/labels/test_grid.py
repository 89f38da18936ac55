"""The label grid of a frame: against a loop over voxels, and that no pose makes a hole in a closed surface."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from stone.geometry.lattice import keys_from_indices
from stone.geometry.se3 import SE3
from stone.labels.columns import spread_out
from stone.labels.crops import cut
from stone.labels.grid import GRID_MAX_M, GRID_MIN_M, GRID_SHAPE, frame_bounds, window_of
from stone.labels.observed_voxels import BRICK, Observed
from stone.labels.pinholes import FRACTION_BITS
from stone.labels.voxels import VOXEL_M
from tests.observed_voxels import voxel_keys

NOTHING = Observed(np.zeros(0, np.int64), np.zeros(0, np.uint64))
SEEDS = st.integers(0, 2**32)


def pose(x=0.0, y=0.0, z=0.0, yaw=0.0, pitch=0.0, roll=0.0):
    """map_from_ego by yaw, then pitch, then roll, in radians."""
    turns = [
        np.array([math.cos(yaw / 2), 0, 0, math.sin(yaw / 2)]),
        np.array([math.cos(pitch / 2), 0, math.sin(pitch / 2), 0]),
        np.array([math.cos(roll / 2), math.sin(roll / 2), 0, 0]),
    ]
    yawed, pitched, rolled = (SE3.from_parts(turn, np.zeros(3)) for turn in turns)
    return SE3.from_parts((yawed @ pitched @ rolled).wxyz, np.array([x, y, z]))


poses = st.builds(
    pose,
    *[st.floats(-60, 60)] * 2,
    st.floats(-0.8, 0.8),
    yaw=st.floats(-math.pi, math.pi),
    pitch=st.floats(-0.35, 0.35),
    roll=st.floats(-0.35, 0.35),
)


def crop(window, map_from_ego):
    """(classes, observed 0/1), both of `GRID_SHAPE`, of the frame at this pose."""
    columns = cut(window, map_from_ego)
    return spread_out(columns.ones, columns.twos), spread_out(columns.observed)


def window_at(indices, classes, map_from_ego, observed=NOTHING):
    """The window of the labelled voxels (K, 3) around a pose."""
    keys = keys_from_indices(indices)
    order = np.argsort(keys)
    return window_of(keys[order], classes[order].astype(np.uint8), observed, frame_bounds(map_from_ego))


def sheet_across(axis, place, map_from_ego):
    """A closed one-voxel sheet at index `place` of one map axis, as wide as the window, with classes by column."""
    low, high = frame_bounds(map_from_ego)
    spans = [np.arange(a, b) for a, b in zip(low, high, strict=True)]
    spans[axis] = np.array([place])
    indices = np.stack(np.meshgrid(*spans, indexing="ij"), axis=-1).reshape(-1, 3)
    return indices, 1 + indices.sum(axis=1) % 3


def centres_map(map_from_ego):
    index = np.stack(np.meshgrid(*[np.arange(n) for n in GRID_SHAPE], indexing="ij"), axis=-1)
    return map_from_ego @ ((index + 0.5) * VOXEL_M + np.array(GRID_MIN_M))


def cloud_around(map_from_ego, seed, count=200_000):
    low, high = frame_bounds(map_from_ego)
    rng = np.random.default_rng(seed)
    indices = np.unique(rng.integers(low - 3, high + 3, (count, 3)), axis=0)
    return indices, rng.integers(1, 4, len(indices))


@settings(max_examples=6, deadline=None)
@given(poses, SEEDS)
def test_a_voxel_has_the_class_of_the_map_voxel_that_holds_its_centre(map_from_ego, seed):
    """Catches alone a crop that is off by a voxel at some pose: every centre is looked up one by one."""
    indices, kinds = cloud_around(map_from_ego, seed)
    lookup = {tuple(row): kind for row, kind in zip(indices.tolist(), kinds.tolist(), strict=True)}
    classes, _ = crop(window_at(indices, kinds, map_from_ego), map_from_ego)
    scaled = centres_map(map_from_ego) / VOXEL_M
    rng = np.random.default_rng(seed)
    for a, b, c in rng.integers(0, GRID_SHAPE, (4000, 3)):
        at = scaled[a, b, c]
        if np.abs(at - np.round(at)).min() < 1e-3:  # the grid's fixed point has 2^-20 voxels a step
            continue
        expected = lookup.get(tuple(int(i) for i in np.floor(at)), 0)
        if expected:
            assert classes[a, b, c] == expected


def steps_over(a, b, labelled):
    """Whether the way between two points, in voxel units, passes a labelled voxel: looked up between its crossings."""
    borders = [np.arange(math.ceil(min(p, q)), math.floor(max(p, q)) + 1) for p, q in zip(a, b, strict=True)]
    crossings = [(at - p) / (q - p) for at, p, q in zip(borders, a, b, strict=True) if p != q]
    ratios = np.sort(np.concatenate([[0.0, 1.0], *crossings]))
    middles = a + (ratios[:-1] + ratios[1:])[:, None] / 2 * (b - a)
    return any(tuple(int(i) for i in np.floor(middle)) in labelled for middle in middles)


@pytest.mark.parametrize("turn", [0.2, 0.8, -2.0])
def test_a_free_centre_is_labelled_only_where_a_step_from_it_crosses_a_label(turn):
    here = pose(3.3, -7.1, 0.2, yaw=turn, pitch=0.1 * turn, roll=-0.05)
    indices, kinds = cloud_around(here, 3, count=120_000)
    labelled = {tuple(row) for row in indices.tolist()}
    classes, _ = crop(window_at(indices, kinds, here), here)
    scaled = centres_map(here) / VOXEL_M
    held = np.isin(keys_from_indices(np.floor(scaled).astype(np.int64).reshape(-1, 3)), keys_from_indices(indices))
    closed = np.argwhere((classes > 0) & ~held.reshape(GRID_SHAPE))
    assert len(closed) > 1000
    steps = np.concatenate([np.eye(3, dtype=int), -np.eye(3, dtype=int)])
    is_crossed = []
    for at in closed[:: len(closed) // 300]:
        ways = [at + step for step in steps if ((at + step >= 0) & (at + step < GRID_SHAPE)).all()]
        is_crossed.append(any(steps_over(scaled[tuple(at)], scaled[tuple(way)], labelled) for way in ways))
    assert np.mean(is_crossed) > 0.99  # the rest graze an edge within the rounding of 2^-20 voxels


def assert_closed(classes, sides):
    """No free region touches both sides of a surface; `sides` is True for the voxels whose centre is beyond it."""
    regions, _ = ndimage.label(classes == 0)
    beyond = set(np.unique(regions[sides & (classes == 0)])) - {0}
    behind = set(np.unique(regions[~sides & (classes == 0)])) - {0}
    assert not beyond & behind


@settings(max_examples=15, deadline=None)
@given(poses)
def test_a_flat_sheet_has_no_pinhole_and_no_way_through_at_any_pose(map_from_ego):
    """Catches alone holes that a turned crop tears into a surface."""
    indices, kinds = sheet_across(2, 0, map_from_ego)
    classes, _ = crop(window_at(indices, kinds, map_from_ego), map_from_ego)
    z = centres_map(map_from_ego)[..., 2]
    crosses = (z[..., 0] < -0.2) & (z[..., -1] > 0.4) | (z[..., 0] > 0.4) & (z[..., -1] < -0.2)
    assert crosses.sum() > 1000
    assert (classes > 0).any(axis=2)[crosses].all()
    assert_closed(classes, z > VOXEL_M / 2)


@settings(max_examples=10, deadline=None)
@given(poses, st.sampled_from([0, 1]))
def test_a_wall_is_not_pierced_at_any_pose(map_from_ego, axis):
    place = math.floor(map_from_ego.translation_m[axis] / VOXEL_M) + 7
    indices, kinds = sheet_across(axis, place, map_from_ego)
    classes, _ = crop(window_at(indices, kinds, map_from_ego), map_from_ego)
    assert (classes > 0).sum() > 5000
    assert_closed(classes, centres_map(map_from_ego)[..., axis] > (place + 0.5) * VOXEL_M)


@settings(max_examples=6, deadline=None)
@given(poses)
def test_a_closed_sheet_is_not_thickened(map_from_ego):
    indices, kinds = sheet_across(2, 0, map_from_ego)
    classes, _ = crop(window_at(indices, kinds, map_from_ego), map_from_ego)
    z = centres_map(map_from_ego)[..., 2]
    off_m = np.abs(z[classes > 0] - VOXEL_M / 2)
    # a voxel centre takes the class when a step from it, at most half a voxel long in z, reaches the sheet
    assert off_m.max() <= VOXEL_M / 2 + VOXEL_M / 2 + 1e-5


@settings(max_examples=5, deadline=None)
@given(SEEDS, *[st.integers(-400, 400)] * 3)
def test_moving_the_world_by_whole_voxels_moves_nothing_in_the_grid(seed, i, j, k):
    here = pose(0.03, 0.17, 0.05, yaw=0.7, pitch=0.1, roll=-0.05)
    shift = np.array([i, j, k])
    there = SE3.from_parts(here.wxyz, here.translation_m + shift * VOXEL_M)
    indices, kinds = cloud_around(here, seed)
    a, _ = crop(window_at(indices, kinds, here), here)
    b, _ = crop(window_at(indices + shift, kinds, there), there)
    assert (a != b).mean() < 1e-5  # a centre within rounding (2^-20 voxels) of a border may fall to either side


@pytest.mark.parametrize("quarters", [0, 1, 2, 3])
def test_a_quarter_turn_is_exact(quarters):
    indices, kinds = cloud_around(pose(), 11)
    level, _ = crop(window_at(indices, kinds, pose()), pose())
    turned_pose = pose(yaw=quarters * math.pi / 2)
    turned, _ = crop(window_at(indices, kinds, turned_pose), turned_pose)
    assert (turned == np.rot90(level, -quarters, axes=(0, 1))).all()
    assert (level > 0).sum() > 10_000


def test_an_aligned_grid_is_the_map_itself():
    here = pose(4.0, -6.0, 1.0)
    indices, kinds = cloud_around(here, 5)
    low = np.round((here.translation_m + np.array(GRID_MIN_M)) / VOXEL_M).astype(int)
    expected = np.zeros(GRID_SHAPE, np.uint8)
    at = indices - low
    inside = ((at >= 0) & (at < GRID_SHAPE)).all(axis=1)
    expected[tuple(at[inside].T)] = kinds[inside]
    classes, _ = crop(window_at(indices, kinds, here), here)
    assert (classes == expected).all()


@settings(max_examples=4, deadline=None)
@given(poses, SEEDS)
def test_a_voxel_is_observed_where_the_map_voxel_at_its_centre_is(map_from_ego, seed):
    low, high = frame_bounds(map_from_ego)
    rng = np.random.default_rng(seed)
    bricks = np.unique(keys_from_indices(rng.integers(low // BRICK, high // BRICK + 1, (3000, 3))))
    observed = Observed(bricks, rng.integers(0, 2**64, len(bricks), dtype=np.uint64))
    none = np.zeros((0, 3), np.int64)
    classes, seen = crop(window_at(none, none[:, 0], map_from_ego, observed), map_from_ego)
    scaled = centres_map(map_from_ego) / VOXEL_M
    expected = np.isin(keys_from_indices(np.floor(scaled).astype(np.int64).reshape(-1, 3)), voxel_keys(observed))
    clear = (np.abs(scaled - np.round(scaled)) > 1e-3).all(axis=-1)
    assert (seen[clear] == expected.reshape(GRID_SHAPE)[clear]).all()
    assert seen.any()
    assert not classes.any()


@settings(max_examples=30, deadline=None)
@given(poses)
def test_the_bounds_of_a_frame_hold_its_whole_grid(map_from_ego):
    low, high = frame_bounds(map_from_ego)
    corners = np.array([[a, b, c] for a in (0, 1) for b in (0, 1) for c in (0, 1)])
    corners = np.array(GRID_MIN_M) + corners * (np.array(GRID_MAX_M) - np.array(GRID_MIN_M))
    voxels = np.floor((map_from_ego @ corners) / VOXEL_M)
    assert (voxels > low).all()
    assert (voxels < high - 1).all()


def test_the_bounds_of_many_frames_hold_each():
    both = SE3(np.stack([pose(yaw=0.3).wxyz_xyz, pose(30, 9, yaw=2).wxyz_xyz]))
    low, high = frame_bounds(both)
    for i in range(2):
        one_low, one_high = frame_bounds(both[i])
        assert (low <= one_low).all()
        assert (high >= one_high).all()


def test_outside_the_window_all_is_free_and_unobserved():
    here, far = pose(), pose(500.0)
    indices, kinds = cloud_around(here, 1)
    classes, observed = crop(window_at(indices, kinds, here), far)
    assert not classes.any()
    assert not observed.any()


def test_the_grid_is_the_declared_one():
    spans = (np.array(GRID_MAX_M) - np.array(GRID_MIN_M)) / VOXEL_M
    np.testing.assert_allclose(spans, GRID_SHAPE, atol=1e-9)
    assert max(GRID_SHAPE) < 2**FRACTION_BITS
