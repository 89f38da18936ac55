"""Counts of labels against counting them with numpy."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from services.labeler.imports.label_counts import class_counts, set_count
from stone.labels.grid import GRID_SHAPE, Grid


def drawn(seed: int, highest: int, share: float) -> Grid:
    random = np.random.default_rng(seed)
    grid = random.integers(0, highest + 1, GRID_SHAPE, np.uint8)
    grid[random.random(GRID_SHAPE) > share] = 0
    return grid


@given(st.integers(0, 2**31), st.sampled_from([0.0, 0.02, 1.0]), st.booleans())
@settings(max_examples=10, deadline=None)
def test_voxels_are_counted_by_class_wherever_the_grid_lies_in_memory(
    seed: int, share: float, is_shifted: bool
) -> None:
    grid = drawn(seed, 3, share)
    if is_shifted:
        grid = np.frombuffer(b"x" + grid.tobytes(), np.uint8, grid.size, 1).reshape(GRID_SHAPE)
    assert class_counts(grid) == np.bincount(grid.reshape(-1), minlength=4).tolist()


@given(st.integers(0, 2**31), st.sampled_from([0.0, 0.5, 1.0]))
@settings(max_examples=6, deadline=None)
def test_voxels_of_a_mask_are_counted(seed: int, share: float) -> None:
    mask = drawn(seed, 1, share)
    assert set_count(mask) == int(mask.sum())
