"""Bit planes count exactly what a plain histogram counts, ring by ring."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from stone.errors import ShapeError
from stone.labels.grid import GRID_SHAPE
from stone.scoring.bitplanes import COLUMNS, RINGS, LabelRangeError, column_rings, frame_counts, truth_planes
from tests.plain_confusion import confusion_matrix

Grid = NDArray[np.uint8]


def random_grid(seed: int, occupied_ratio: float) -> Grid:
    rng = np.random.default_rng(seed)
    is_occupied = rng.random(GRID_SHAPE, dtype=np.float32) < occupied_ratio
    return np.where(is_occupied, rng.integers(0, 4, GRID_SHAPE), 0).astype(np.uint8)


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0, 1), st.floats(0, 1))
def test_each_ring_counts_as_a_histogram_does(seed: int, occupied_ratio: float, evaluated_ratio: float) -> None:
    truth, prediction = random_grid(seed, occupied_ratio), random_grid(seed + 1, 1 - occupied_ratio)
    is_evaluated = np.random.default_rng(seed + 2).random(GRID_SHAPE, dtype=np.float32) < evaluated_ratio
    counted = frame_counts(prediction, truth_planes(truth, is_evaluated)).confusion
    assert counted.dtype == np.int32
    rings = column_rings().reshape(*GRID_SHAPE[:2], 1)
    for ring in range(RINGS):
        np.testing.assert_array_equal(
            counted[ring], confusion_matrix(truth, prediction, is_evaluated & (rings == ring))
        )


def test_a_column_lies_in_the_ring_of_its_distance_from_the_robot() -> None:
    rings = column_rings().reshape(GRID_SHAPE[:2])
    for x, y in [(128, 128), (128, 177), (128, 178), (177, 128), (178, 128), (128, 227), (128, 228), (0, 0), (92, 163)]:
        distance_m = ((x * 0.2 - 25.5) ** 2 + (y * 0.2 - 25.5) ** 2) ** 0.5
        assert rings[x, y] == (distance_m >= 10) + (distance_m >= 20)
    assert np.bincount(rings.ravel()).sum() == COLUMNS


def test_a_value_above_three_is_refused_even_where_nothing_is_evaluated() -> None:
    nothing = truth_planes(np.zeros(GRID_SHAPE, np.uint8), np.zeros(GRID_SHAPE, np.bool_))
    for value in (4, 128, 255):
        grid = np.zeros(GRID_SHAPE, np.uint8)
        grid[200, 17, 31] = value
        with pytest.raises(LabelRangeError, match=f"a voxel holds {value}; classes are 0 to 3"):
            frame_counts(grid, nothing)


def test_other_shapes_and_types_are_refused() -> None:
    everywhere = np.ones(GRID_SHAPE, np.bool_)
    with pytest.raises(ShapeError, match="a label grid has shape"):
        truth_planes(np.zeros((32, 256, 256), np.uint8), everywhere)
    with pytest.raises(ShapeError, match="not int64"):
        truth_planes(np.zeros(GRID_SHAPE, np.int64), everywhere)
    with pytest.raises(ShapeError, match="is_evaluated"):
        truth_planes(np.zeros(GRID_SHAPE, np.uint8), everywhere[:1])


def test_memory_order_does_not_matter() -> None:
    truth, prediction = random_grid(1, 0.3), random_grid(2, 0.3)
    planes = truth_planes(truth, np.ones(GRID_SHAPE, np.bool_))
    same = frame_counts(np.asfortranarray(prediction), planes)
    np.testing.assert_array_equal(same.confusion, frame_counts(prediction, planes).confusion)
    np.testing.assert_array_equal(same.bev, frame_counts(prediction, planes).bev)
