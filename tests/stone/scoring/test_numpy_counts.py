"""The counts by NumPy equal those of the kernels and of the slow metric."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from stone.errors import ShapeError
from stone.scoring import bitplanes, numpy_counts
from stone.scoring.frame_counts import LabelRangeError, no_column_counts
from stone_base.label_grid import OCC3D, PAPER, RELEASE, LabelGrid
from tests.slow_metric import Counts, slow_counts

FORWARD = LabelGrid("forward", (2.0, -3.7, -1.0), 0.2, (136, 72, 8))
GRIDS = st.sampled_from([PAPER, RELEASE, OCC3D, FORWARD])
Grid = NDArray[np.uint8]


def labels(rng: np.random.Generator, grid: LabelGrid, occupied_ratio: float) -> Grid:
    is_occupied = rng.random(grid.shape, np.float32) < occupied_ratio
    return np.where(is_occupied, rng.integers(0, 4, grid.shape), 0).astype(np.uint8)


@settings(max_examples=12, deadline=None)
@given(GRIDS, st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.02, 0.6, 1.0]), st.sampled_from([0.0, 0.3, 1.0]))
def test_planes_and_counts_are_those_of_the_kernels(
    grid: LabelGrid, seed: int, occupied_ratio: float, evaluated_ratio: float
) -> None:
    rng = np.random.default_rng(seed)
    truth, prediction = labels(rng, grid, occupied_ratio), labels(rng, grid, occupied_ratio)
    is_evaluated = rng.random(grid.shape, np.float32) < evaluated_ratio
    is_late = rng.random(grid.shape, np.float32) < 0.2
    ours, theirs = (of.truth_planes(truth, is_evaluated, grid, is_late) for of in (numpy_counts, bitplanes))
    for name in ("planes", "counts", "late"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))
    expected = bitplanes.frame_counts(prediction, theirs)
    confusion, bev, columns = np.empty_like(expected.confusion), np.empty_like(expected.bev), no_column_counts(())
    numpy_counts.count_by_ring(prediction, ours, confusion, bev, columns)
    np.testing.assert_array_equal(confusion, expected.confusion)
    np.testing.assert_array_equal(bev, expected.bev)
    np.testing.assert_array_equal(columns.pairs, expected.column_counts.pairs)
    np.testing.assert_array_equal(columns.columns, expected.column_counts.columns)
    late = (of.late_confusion(prediction, ours) for of in (numpy_counts, bitplanes))
    np.testing.assert_array_equal(*late)


def test_counts_are_those_of_the_slow_metric() -> None:
    rng = np.random.default_rng(5)
    truth, prediction = labels(rng, FORWARD, 0.4), labels(rng, FORWARD, 0.4)
    is_evaluated = rng.random(FORWARD.shape) < 0.6
    place = tuple(round(1000 * length_m) for length_m in (*FORWARD.min_m[:2], FORWARD.voxel_m))
    confusion, bev, columns = np.zeros((3, 4, 4), np.int32), np.zeros((3, 3), np.int32), no_column_counts(())
    planes = numpy_counts.truth_planes(truth, is_evaluated, FORWARD)
    numpy_counts.count_by_ring(prediction, planes, confusion, bev, columns)
    found = Counts(*(array.tolist() for array in (confusion, bev, columns.pairs, columns.columns)))
    assert found == slow_counts(truth, prediction, is_evaluated, place)  # type: ignore[arg-type]


def test_other_shapes_and_labels_above_3_are_refused() -> None:
    is_evaluated = np.ones(FORWARD.shape, np.bool_)
    with pytest.raises(ShapeError):
        numpy_counts.truth_planes(np.zeros(PAPER.shape, np.uint8), is_evaluated, FORWARD)
    with pytest.raises(LabelRangeError):
        numpy_counts.truth_planes(np.full(FORWARD.shape, 255, np.uint8), is_evaluated, FORWARD)
