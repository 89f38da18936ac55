"""Frames cut in words of 32 voxels, against a grid of positions looked up one by one, gaps closed in turn."""

import numpy as np
import pytest

from stone.geometry.lattice import keys_from_indices
from stone.geometry.se3 import SE3
from stone.labels.columns import Columns, gathered, reconcile, spread_out
from stone.labels.confidence import MOST, NO_SURFACE, cut_with_distances, map_distances
from stone.labels.crops import cut, cut_batch, placing_of
from stone.labels.grid import GRID_SHAPE, frame_bounds, window_bytes, window_of
from stone.labels.observed_voxels import BRICK, Observed
from stone.labels.pinholes import FRACTION_BITS
from tests.observed_voxels import voxel_keys

AXES = np.eye(3, dtype=np.int64)


def pose(*wxyz):
    return SE3.from_parts(np.array(wxyz) / np.linalg.norm(wxyz), np.array([3.3, -7.1, 0.4]))


POSES = {
    "level": pose(0.9, 0.0, 0.0, 0.4),
    "tilted": pose(0.8, 0.15, -0.1, 0.5),
    "upside down": pose(0.1, 0.9, 0.3, 0.2),
}


def classes_of(columns):
    return spread_out(columns.ones, columns.twos)


class World:
    """Random labelled voxels and observed bricks around a pose, as dense arrays over the window's range too."""

    def __init__(self, map_from_ego, seed):
        rng = np.random.default_rng(seed)
        self.bounds = low, high = frame_bounds(map_from_ego)
        self.indices = np.unique(rng.integers(low - 3, high + 3, (60_000, 3)), axis=0)
        self.classes = rng.integers(1, 4, len(self.indices)).astype(np.uint8)
        self.squared = rng.exponential(20, len(self.indices))
        bricks = np.unique(rng.integers(low // BRICK - 1, high // BRICK + 2, (20_000, 3)), axis=0)
        self.observed = Observed(keys_from_indices(bricks), rng.integers(0, 2**64, len(bricks), dtype=np.uint64))
        self.keys = keys_from_indices(self.indices)
        self.window = window_of(self.keys, self.classes, self.observed, self.bounds)

    def at(self, positions):
        """Rows of `indices` of map voxels (…, 3), −1 where none is labelled."""
        keys = keys_from_indices(positions.reshape(-1, 3))
        row = np.minimum(np.searchsorted(self.keys, keys), len(self.keys) - 1)
        return np.where(self.keys[row] == keys, row, -1).reshape(positions.shape[:-1])


def fixed_point(world, map_from_ego):
    """Position (256, 256, 32, 3) of every centre in the map, in voxels times 2^20, whole numbers."""
    placing = placing_of(world.window, map_from_ego)
    index = np.stack(np.meshgrid(*[np.arange(n) for n in GRID_SHAPE], indexing="ij"), axis=-1)
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


def rows_of(world, map_from_ego):
    """The labelled voxel (its row) each voxel of the grid has its class from, −1 for none; and how many close gaps."""
    positions = fixed_point(world, map_from_ego)
    held = world.at(positions >> FRACTION_BITS)
    rows, closing = held.copy(), gaps(world, positions, held)
    for a, b, c, axis, row, is_nearer in closing:
        rows[tuple((np.array([a, b, c]) - (0 if is_nearer else AXES[axis])).tolist())] = row
    return rows, len(closing)


@pytest.fixture(scope="module", params=POSES)
def case(request):
    map_from_ego = POSES[request.param]
    world = World(map_from_ego, len(request.param))
    return world, map_from_ego, *rows_of(world, map_from_ego)


def test_a_frame_is_its_voxels_looked_up_one_by_one_and_its_gaps_closed_in_turn(case):
    world, map_from_ego, rows, closed = case
    classes = classes_of(cut(world.window, map_from_ego))
    assert (classes == np.where(rows >= 0, world.classes[rows], 0)).all()
    assert closed > 1000


def test_a_frame_is_observed_voxel_by_voxel(case):
    world, map_from_ego, *_ = case
    keys = keys_from_indices((fixed_point(world, map_from_ego) >> FRACTION_BITS).reshape(-1, 3))
    expected = np.isin(keys, voxel_keys(world.observed)).reshape(GRID_SHAPE)
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


def test_each_voxel_has_the_distance_of_the_map_voxel_whose_class_it_took(case):
    world, map_from_ego, rows, _ = case
    columns, squared = cut_with_distances(world.window, map_from_ego, map_distances(world.keys, world.squared))
    expected = np.where(rows >= 0, world.squared[rows].astype(np.float16), NO_SURFACE)
    assert squared.dtype == np.float16
    assert (squared == expected).all()
    assert (classes_of(columns) == classes_of(cut(world.window, map_from_ego))).all()


def test_a_distance_beyond_float16_ends_at_its_greatest_value():
    far = map_distances(np.array([3, 5], np.int64), np.array([1e9, 7.0]))
    assert far.squared.tolist() == [MOST, 7.0]


def test_the_weight_of_a_window_is_known_before_it_is_made():
    bounds = frame_bounds(POSES["tilted"])
    nothing = Observed(np.zeros(0, np.int64), np.zeros(0, np.uint64))
    window = window_of(np.zeros(0, np.int64), np.zeros(0, np.uint8), nothing, bounds)
    assert window.voxels.nbytes == window_bytes(bounds)


def test_a_window_whose_voxels_cannot_be_counted_is_refused_before_it_is_made():
    wide = np.zeros(3, np.int64), np.array([2000, 2000, 600])
    with pytest.raises(ValueError, match="2412818408 bytes"):
        window_of(np.zeros(0, np.int64), np.zeros(0, np.uint8), Observed(np.zeros(0, np.int64), np.zeros(0)), wide)


def test_columns_are_the_grid_bit_by_bit():
    rng = np.random.default_rng(2)
    grid = rng.integers(0, 4, GRID_SHAPE, dtype=np.uint8)
    ones, twos = gathered(grid & 1), gathered(grid & 2)
    assert (spread_out(ones, twos) == grid).all()
    assert ones[7, 9] == sum(int(grid[7, 9, z] & 1) << z for z in range(32))


def test_masks_agree_and_are_counted():
    rng = np.random.default_rng(3)
    classes = (rng.integers(0, 4, GRID_SHAPE) * (rng.uniform(size=GRID_SHAPE) < 0.1)).astype(np.uint8)
    observed, visible = rng.integers(0, 2, (2, *GRID_SHAPE)).astype(np.uint8)
    columns = Columns(gathered(classes & 1), gathered(classes & 2), gathered(observed))
    masks = reconcile(columns, gathered(visible))
    expected = observed | (classes > 0)
    assert (spread_out(masks.observed) == expected).all()
    assert (spread_out(masks.visible) == visible & expected).all()
    assert masks.by_class.tolist() == np.bincount(classes.ravel(), minlength=4).tolist()
    assert masks.by_mask.tolist() == [expected.sum(), (visible & expected).sum()]


@pytest.mark.parametrize("far_m", [10.0, 12.8, 19.2, 75.0, 1e5])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_frame_beside_the_window_is_free_and_unobserved(axis, far_m):
    """Above it, below it and to all sides: what is looked up there is asked for first."""
    world, place = World(POSES["level"], 4), POSES["level"].translation_m
    for way in (-1, 1):
        shifted = place + way * (far_m if axis == 2 else far_m + 75.0) * np.eye(3)[axis]
        columns = cut(world.window, SE3.from_parts(POSES["level"].wxyz, shifted))
        assert not columns.occupied.any()
        assert not columns.observed.any()
