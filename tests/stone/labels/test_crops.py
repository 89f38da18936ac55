"""Frames cut in words of 32 voxels, voxel by voxel; no pose makes a hole in a closed surface."""

import math
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from stone.geometry.lattice import keys_from_indices, table_of
from stone.geometry.se3 import SE3
from stone.labels.columns import Columns, gathered, reconcile, spread_out
from stone.labels.crops import cut, cut_batch, cut_with_rows, placing_of
from stone.labels.grid import frame_bounds, window_bytes, window_of
from stone.labels.observed_voxels import BRICK, NOTHING, Observed
from stone.labels.pinholes import FRACTION_BITS
from stone.labels.pooling import pooled
from stone.labels.voxels import VOXEL_M
from stone_base.label_grid import PAPER, RELEASE, LabelGrid
from tests.observed_voxels import voxel_keys

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


def cropped(indices, classes, map_from_ego):
    """The classes of `PAPER.shape` of the frame at this pose, in a map of the labelled voxels (K, 3)."""
    keys = keys_from_indices(indices)
    order = np.argsort(keys)
    window = window_of(keys[order], classes[order].astype(np.uint8), NOTHING, frame_bounds(map_from_ego))
    return classes_of(cut(window, map_from_ego))


def sheet_across(axis, place, map_from_ego):
    """A closed one-voxel sheet at index `place` of one map axis, as wide as the window, with classes by column."""
    low, high = frame_bounds(map_from_ego)
    spans = [np.arange(a, b) for a, b in zip(low, high, strict=True)]
    spans[axis] = np.array([place])
    indices = np.stack(np.meshgrid(*spans, indexing="ij"), axis=-1).reshape(-1, 3)
    return indices, 1 + indices.sum(axis=1) % 3


def centres_map(map_from_ego):
    index = np.stack(np.meshgrid(*[np.arange(n) for n in PAPER.shape], indexing="ij"), axis=-1)
    return map_from_ego @ ((index + 0.5) * VOXEL_M + np.array(PAPER.min_m))


def cloud_around(map_from_ego, seed, count=200_000):
    low, high = frame_bounds(map_from_ego)
    rng = np.random.default_rng(seed)
    indices = np.unique(rng.integers(low - 3, high + 3, (count, 3)), axis=0)
    return indices, rng.integers(1, 4, len(indices))


@pytest.mark.whole
@settings(max_examples=3, deadline=None)
@given(poses, SEEDS)
def test_a_voxel_has_the_class_of_the_map_voxel_that_holds_its_centre(map_from_ego, seed):
    """Catches alone a crop that is off by a voxel at some pose: every centre is looked up one by one."""
    indices, kinds = cloud_around(map_from_ego, seed)
    lookup = {tuple(row): kind for row, kind in zip(indices.tolist(), kinds.tolist(), strict=True)}
    classes = cropped(indices, kinds, map_from_ego)
    scaled = centres_map(map_from_ego) / VOXEL_M
    rng = np.random.default_rng(seed)
    for a, b, c in rng.integers(0, PAPER.shape, (4000, 3)):
        at = scaled[a, b, c]
        if np.abs(at - np.round(at)).min() < 1e-3:  # the grid's fixed point has 2^-20 voxels a step
            continue
        expected = lookup.get(tuple(int(i) for i in np.floor(at)), 0)
        if expected:
            assert classes[a, b, c] == expected


def assert_closed(classes, sides):
    """No free region touches both sides of a surface; `sides` is True for the voxels whose centre is beyond it."""
    regions, _ = ndimage.label(classes == 0)
    beyond = set(np.unique(regions[sides & (classes == 0)])) - {0}
    behind = set(np.unique(regions[~sides & (classes == 0)])) - {0}
    assert not beyond & behind


@pytest.mark.whole
@settings(max_examples=6, deadline=None)
@given(poses)
def test_a_flat_sheet_has_no_pinhole_and_no_way_through_at_any_pose(map_from_ego):
    """Catches alone holes that a turned crop tears into a surface."""
    indices, kinds = sheet_across(2, 0, map_from_ego)
    classes = cropped(indices, kinds, map_from_ego)
    z = centres_map(map_from_ego)[..., 2]
    crosses = (z[..., 0] < -0.2) & (z[..., -1] > 0.4) | (z[..., 0] > 0.4) & (z[..., -1] < -0.2)
    assert crosses.sum() > 1000
    assert (classes > 0).any(axis=2)[crosses].all()
    assert_closed(classes, z > VOXEL_M / 2)
    # a voxel centre takes the class when a step from it, at most half a voxel long in z, reaches the sheet: no thicker
    assert np.abs(z[classes > 0] - VOXEL_M / 2).max() <= VOXEL_M / 2 + VOXEL_M / 2 + 1e-5


@pytest.mark.whole
@settings(max_examples=4, deadline=None)
@given(poses, st.sampled_from([0, 1]))
def test_a_wall_is_not_pierced_at_any_pose(map_from_ego, axis):
    place = math.floor(map_from_ego.translation_m[axis] / VOXEL_M) + 7
    indices, kinds = sheet_across(axis, place, map_from_ego)
    classes = cropped(indices, kinds, map_from_ego)
    assert (classes > 0).sum() > 5000
    assert_closed(classes, centres_map(map_from_ego)[..., axis] > (place + 0.5) * VOXEL_M)


@settings(max_examples=3, deadline=None)
@given(SEEDS, *[st.integers(-400, 400)] * 3)
def test_moving_the_world_by_whole_voxels_moves_nothing_in_the_grid(seed, i, j, k):
    here = pose(0.03, 0.17, 0.05, yaw=0.7, pitch=0.1, roll=-0.05)
    shift = np.array([i, j, k])
    there = SE3.from_parts(here.wxyz, here.translation_m + shift * VOXEL_M)
    indices, kinds = cloud_around(here, seed)
    a, b = cropped(indices, kinds, here), cropped(indices + shift, kinds, there)
    assert (a != b).mean() < 1e-5  # a centre within rounding (2^-20 voxels) of a border may fall to either side


@pytest.mark.whole
@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_a_quarter_turn_is_exact(quarters):
    indices, kinds = cloud_around(pose(), 11)
    level, turned = (cropped(indices, kinds, pose(yaw=turns * math.pi / 2)) for turns in (0, quarters))
    assert (turned == np.rot90(level, -quarters, axes=(0, 1))).all()
    assert (level > 0).sum() > 10_000


def test_an_aligned_grid_is_the_map_itself():
    here = pose(4.0, -6.0, 1.0)
    indices, kinds = cloud_around(here, 5)
    low = np.round((here.translation_m + np.array(PAPER.min_m)) / VOXEL_M).astype(int)
    expected = np.zeros(PAPER.shape, np.uint8)
    at = indices - low
    inside = ((at >= 0) & (at < PAPER.shape)).all(axis=1)
    expected[tuple(at[inside].T)] = kinds[inside]
    classes = cropped(indices, kinds, here)
    assert (classes == expected).all()


@settings(max_examples=30, deadline=None)
@given(poses)
def test_the_bounds_of_a_frame_hold_its_whole_grid(map_from_ego):
    low, high = frame_bounds(map_from_ego)
    corners = np.array([[a, b, c] for a in (0, 1) for b in (0, 1) for c in (0, 1)])
    corners = np.array(PAPER.min_m) + corners * (np.array(PAPER.max_m) - np.array(PAPER.min_m))
    voxels = np.floor((map_from_ego @ corners) / VOXEL_M)
    assert (voxels > low).all()
    assert (voxels < high - 1).all()
    both_low, both_high = frame_bounds(SE3(np.stack([map_from_ego.wxyz_xyz, pose(30, 9, yaw=2).wxyz_xyz])))
    assert (both_low <= low).all()
    assert (both_high >= high).all()


def test_the_grid_is_the_declared_one():
    spans = (np.array(PAPER.max_m) - np.array(PAPER.min_m)) / VOXEL_M
    np.testing.assert_allclose(spans, PAPER.shape, atol=1e-9)
    assert max(PAPER.shape) < 2**FRACTION_BITS


AXES = np.eye(3, dtype=np.int64)


TURNS = {"level": [0.9, 0.0, 0.0, 0.4], "tilted": [0.8, 0.15, -0.1, 0.5], "upside down": [0.1, 0.9, 0.3, 0.2]}
POSES = {name: SE3.from_parts(np.array(turn), np.array([3.3, -7.1, 0.4])) for name, turn in TURNS.items()}


def classes_of(columns):
    return spread_out(columns.ones, columns.twos)


class World:
    """Random labelled voxels and observed bricks around a pose, as dense arrays over the window's range too."""

    def __init__(self, map_from_ego, seed, grid=PAPER):
        rng = np.random.default_rng(seed)
        self.bounds = low, high = frame_bounds(map_from_ego, grid)
        self.indices = np.unique(rng.integers(low - 3, high + 3, (60_000, 3)), axis=0)
        self.classes = rng.integers(1, 4, len(self.indices)).astype(np.uint8)
        bricks = np.unique(rng.integers(low // BRICK - 1, high // BRICK + 2, (20_000, 3)), axis=0)
        words, since = rng.integers(0, 2**64, len(bricks), dtype=np.uint64), np.zeros(len(bricks), np.int32)
        self.observed = Observed(keys_from_indices(bricks), words, since)
        self.keys = keys_from_indices(self.indices)
        self.window = window_of(self.keys, self.classes, self.observed, self.bounds)

    def at(self, positions):
        """Rows of `indices` of map voxels (…, 3), −1 where none is labelled."""
        keys = keys_from_indices(positions.reshape(-1, 3))
        row = np.minimum(np.searchsorted(self.keys, keys), len(self.keys) - 1)
        return np.where(self.keys[row] == keys, row, -1).reshape(positions.shape[:-1])


def fixed_point(world, map_from_ego, grid=PAPER):
    """Position (256, 256, 32, 3) of every centre in the map, in voxels times 2^20, whole numbers."""
    placing = placing_of(world.window, map_from_ego, grid)
    index = np.stack(np.meshgrid(*[np.arange(n) for n in grid.shape], indexing="ij"), axis=-1)
    return placing.start + index @ placing.step.T + (world.window.origin << FRACTION_BITS)


def gaps(world, positions, held):
    """[(free voxel, axis, row that its way back crosses, whether it is the nearer end)], in the order of the grid."""
    found = []
    for axis in range(3):
        here = tuple(slice(1, None) if a == axis else slice(None) for a in range(3))
        back = tuple(slice(None, -1) if a == axis else slice(None) for a in range(3))
        a, b = positions[back], positions[here]
        slanted = ((a >> FRACTION_BITS) != (b >> FRACTION_BITS)).sum(axis=-1) > 1
        ends = np.argwhere((held[back] < 0) & (held[here] < 0) & slanted)
        for at, row, ratio in first_crossed(world, a[tuple(ends.T)], b[tuple(ends.T)], ends + AXES[axis]):
            found.append((*at, axis, row, ratio >= 0.5))
    return sorted(found)


def first_crossed(world, a, b, ends):
    """The first labelled voxel on each straight way a → b (N, 3) and where from 0 to 1 the way enters it."""
    border = np.maximum(a >> FRACTION_BITS, b >> FRACTION_BITS) << FRACTION_BITS
    moves = (a >> FRACTION_BITS) != (b >> FRACTION_BITS)
    ratio = np.where(moves, (border - a) / np.where(moves, b - a, 1), 2.0)
    left, cell, row_at = moves.copy(), a >> FRACTION_BITS, np.full(len(a), -1)
    entered = np.zeros(len(a))
    for _ in range(2):
        axis = np.argmin(np.where(left, ratio, 3.0), axis=1)
        line = np.arange(len(a))
        cell[line, axis] = (b >> FRACTION_BITS)[line, axis]
        left[line, axis] = False
        row = np.where((row_at < 0) & left.any(axis=1), world.at(cell), -1)
        entered = np.where(row >= 0, ratio[line, axis], entered)
        row_at = np.where(row >= 0, row, row_at)
    hit = np.flatnonzero(row_at >= 0)
    return zip(ends[hit].tolist(), row_at[hit].tolist(), entered[hit].tolist(), strict=True)


def rows_of(world, map_from_ego, grid=PAPER):
    """The labelled voxel (its row) each voxel of the grid has its class from, −1 for none; and how many are filled."""
    positions = fixed_point(world, map_from_ego, grid)
    held = world.at(positions >> FRACTION_BITS)
    rows, closing = held.copy(), gaps(world, positions, held)
    for a, b, c, axis, row, is_nearer in closing:
        rows[tuple((np.array([a, b, c]) - (0 if is_nearer else AXES[axis])).tolist())] = row
    return rows, np.count_nonzero(rows >= 0) - np.count_nonzero(held >= 0)


@pytest.fixture(scope="module", params=POSES)
def case(request):
    map_from_ego = POSES[request.param]
    world = World(map_from_ego, len(request.param))
    return world, map_from_ego, *rows_of(world, map_from_ego)


def test_a_frame_is_its_voxels_looked_up_one_by_one_and_its_gaps_closed_in_turn(case):
    world, map_from_ego, rows, filled = case
    columns = cut(world.window, map_from_ego)
    assert (classes_of(columns) == np.where(rows >= 0, world.classes[rows], 0)).all()
    assert columns.filled == filled > 1000


@pytest.mark.whole
def test_a_frame_is_observed_voxel_by_voxel(case):
    world, map_from_ego, *_ = case
    keys = keys_from_indices((fixed_point(world, map_from_ego) >> FRACTION_BITS).reshape(-1, 3))
    expected = np.isin(keys, voxel_keys(world.observed)).reshape(PAPER.shape)
    assert (spread_out(cut(world.window, map_from_ego).observed) == expected).all()


def test_frames_cut_together_are_those_cut_one_by_one():
    shifts = [SE3.from_parts(np.array([1.0, 0, 0, 0.02 * n]), np.array([0.2 * n, 0, 0.1 * n])) for n in range(5)]
    poses = SE3(np.stack([(POSES["tilted"] @ shift).wxyz_xyz for shift in shifts]))
    world = World(POSES["tilted"], 8)
    together = cut_batch(world.window, poses)
    assert len(together) == 5
    for columns, index in zip(together, range(5), strict=True):
        alone = cut(world.window, poses[index])
        for words, expected in zip(vars(columns).values(), vars(alone).values(), strict=True):
            np.testing.assert_array_equal(words, expected)


def test_each_voxel_has_the_row_of_the_map_voxel_whose_class_it_took(case):
    world, map_from_ego, rows, _ = case
    columns, found = cut_with_rows(world.window, map_from_ego, table_of(world.keys))
    assert (found == rows).all()
    assert (classes_of(columns) == classes_of(cut(world.window, map_from_ego))).all()


@pytest.mark.parametrize("grid", [RELEASE, LabelGrid("deep", (-8.0, -4.0, -2.0), 0.8, (32, 24, 8))], ids=str)
def test_a_larger_voxel_is_pooled_of_the_map_voxels_in_it(grid):
    """By the definition, cube by cube: any occupied, the class of most of them, the highest of equals."""
    fine = grid.on_map
    assert (fine.min_m, fine.max_m, fine.voxel_m) == (grid.min_m, grid.max_m, VOXEL_M)
    world = World(POSES["tilted"], 4)
    cut_fine = cut(world.window, POSES["tilted"], grid=fine)
    columns, n = pooled(cut_fine, grid), grid.pooled
    classes, seen = (spread_out(*words, height=fine.shape[2]) for words in (both(cut_fine), (cut_fine.observed,)))
    found, found_seen = (spread_out(*words, height=grid.shape[2]) for words in (both(columns), (columns.observed,)))
    rng = np.random.default_rng(3)
    for voxel in rng.integers(0, grid.shape, (3000, 3)).tolist():
        cube = tuple(slice(n * at, n * at + n) for at in voxel)
        counts = np.bincount(classes[cube].ravel(), minlength=4)[1:]
        expected = 3 - int(np.argmax(counts[::-1])) if counts.any() else 0
        assert found[tuple(voxel)] == expected
        assert found_seen[tuple(voxel)] == (seen[cube].any() or counts.any())
    assert len(np.unique(found)) == 4


def both(columns):
    return columns.ones, columns.twos


@pytest.mark.parametrize("grid", [RELEASE.on_map, LabelGrid("ahead", (1.3, -7.7, -0.9), 0.2, (72, 104, 16))], ids=str)
def test_a_frame_of_any_grid_is_its_voxels_looked_up_and_its_gaps_closed(grid):
    map_from_ego = POSES["tilted"]
    world = World(map_from_ego, 5, grid)
    rows, filled = rows_of(world, map_from_ego, grid)
    columns = cut(world.window, map_from_ego, grid=grid)
    expected = np.where(rows >= 0, world.classes[rows], 0)
    assert (spread_out(*both(columns), height=grid.shape[2]) == expected).all()
    assert columns.filled == filled > 100
    _, found = cut_with_rows(world.window, map_from_ego, table_of(world.keys), grid)
    assert (found == rows).all()


def test_the_weight_of_a_window_is_known_before_it_is_made():
    bounds = frame_bounds(POSES["tilted"])
    window = window_of(np.zeros(0, np.int64), np.zeros(0, np.uint8), NOTHING, bounds)
    assert window.voxels.nbytes == window_bytes(bounds)


def test_a_window_whose_voxels_cannot_be_counted_is_refused_before_it_is_made():
    wide = np.zeros(3, np.int64), np.array([2000, 2000, 600])
    with pytest.raises(ValueError, match="2412818408 bytes"):
        window_of(np.zeros(0, np.int64), np.zeros(0, np.uint8), NOTHING, wide)


def test_columns_are_the_grid_bit_by_bit():
    rng = np.random.default_rng(2)
    grid = rng.integers(0, 4, PAPER.shape, dtype=np.uint8)
    ones, twos = gathered(grid & 1), gathered(grid & 2)
    assert (spread_out(ones, twos) == grid).all()
    assert ones[7, 9] == sum(int(grid[7, 9, z] & 1) << z for z in range(32))


def test_masks_agree_and_are_counted():
    rng = np.random.default_rng(3)
    classes = (rng.integers(0, 4, PAPER.shape) * (rng.uniform(size=PAPER.shape) < 0.1)).astype(np.uint8)
    observed, visible = rng.integers(0, 2, (2, *PAPER.shape)).astype(np.uint8)
    columns = Columns(gathered(classes & 1), gathered(classes & 2), gathered(observed))
    masks = reconcile(columns, gathered(visible))
    expected = observed | (classes > 0)
    assert (spread_out(masks.observed) == expected).all()
    assert (spread_out(masks.visible) == visible & expected).all()
    assert masks.by_class.tolist() == np.bincount(classes.ravel(), minlength=4).tolist()
    assert masks.by_mask.tolist() == [expected.sum(), (visible & expected).sum()]


def test_a_frame_beside_the_window_is_free_and_unobserved():
    """Above it, below it and to all sides: what is looked up there is asked for first."""
    world, place = World(POSES["level"], 4), POSES["level"].translation_m
    for far_m, axis, way in product((10.0, 12.8, 19.2, 75.0, 1e5), range(3), (-1, 1)):
        shifted = place + way * (far_m if axis == 2 else far_m + 75.0) * np.eye(3)[axis]
        columns = cut(world.window, SE3.from_parts(POSES["level"].wxyz, shifted))
        assert not columns.occupied.any()
        assert not columns.observed.any()
