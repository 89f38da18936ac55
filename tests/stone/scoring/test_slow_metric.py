"""The kernels and the ratios against the slow metric, which shares nothing with them: random grids and edges."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from stone.labels.grid import GRID_SHAPE, Grid
from stone.scoring.bitplanes import LabelRangeError, frame_counts, truth_planes
from stone.scoring.confusion import extras, named_ratios
from stone.scoring.metric import METRICS, RATIOS
from tests.slow_metric import Counts, added, slow_counts, slow_extras, slow_ratios

Mask = NDArray[np.bool_]
EVERYWHERE, NOWHERE = np.ones(GRID_SHAPE, np.bool_), np.zeros(GRID_SHAPE, np.bool_)


def scattered(seed: int, columns: int, classes: tuple[int, ...]) -> Grid:
    """Labels of these classes in this many columns, some of them in the outermost."""
    rng = np.random.default_rng(seed)
    grid = np.zeros(GRID_SHAPE, np.uint8)
    x, y = (np.append(rng.integers(0, 256, columns), [0, 255]) for _ in range(2))
    grid[x, y] = rng.choice([0, *classes], (columns + 2, 32)).astype(np.uint8)
    return grid


def holds(truth: Grid, prediction: Grid, is_evaluated: Mask) -> None:
    """Everything about a frame is what the slow metric says."""
    found, slow = (
        frame_counts(prediction, truth_planes(truth, is_evaluated)),
        slow_counts(truth, prediction, is_evaluated),
    )
    assert Counts(found.confusion.tolist(), found.bev.tolist()) == slow
    cells, columns = added([slow])
    total, bev = found.confusion.sum(axis=0), found.bev.sum(axis=0)
    assert vars(extras(total, bev)) == slow_extras(cells, columns)
    for metric in METRICS:
        named, expected = named_ratios(total, metric), slow_ratios(cells, metric)
        assert [named[name] is None for name in RATIOS] == [expected[name] is None for name in RATIOS]
        assert [named[name] or 0 for name in RATIOS] == pytest.approx(
            [expected[name] or 0 for name in RATIOS], rel=1e-15
        )


CLASSES = st.lists(st.sampled_from([1, 2, 3]), unique=True, max_size=3).map(tuple)


@settings(max_examples=6, deadline=None)
@given(st.integers(0, 2**32 - 1), CLASSES, CLASSES, st.floats(0, 1))
def test_random_grids_count_as_the_slow_metric_counts(
    seed: int, true: tuple[int, ...], predicted: tuple[int, ...], evaluated_ratio: float
) -> None:
    rng = np.random.default_rng(seed)
    truth, prediction = scattered(seed, 2000, true), scattered(seed // 2, 2000, predicted)
    holds(truth, prediction, rng.random(GRID_SHAPE, np.float32) < evaluated_ratio)


def filled(label: int) -> Callable[[], Grid]:
    return lambda: np.full(GRID_SHAPE, label, np.uint8)


@pytest.mark.parametrize("truth", [filled(0), filled(3), lambda: scattered(1, 900, (1, 2))])
@pytest.mark.parametrize("prediction", [filled(0), filled(1), lambda: scattered(2, 900, (1, 2))])
@pytest.mark.parametrize("is_evaluated", [EVERYWHERE, NOWHERE], ids=["everywhere", "nowhere"])
def test_edge_grids_count_as_the_slow_metric_counts(
    truth: Callable[[], Grid], prediction: Callable[[], Grid], is_evaluated: Mask
) -> None:
    holds(truth(), prediction(), is_evaluated)


def test_a_grid_of_255_is_refused_by_both() -> None:
    unknown = np.full(GRID_SHAPE, 255, np.uint8)
    with pytest.raises(LabelRangeError, match="255"):
        frame_counts(unknown, truth_planes(filled(0)(), NOWHERE))
    with pytest.raises(ValueError, match="label_out_of_range"):
        slow_counts(filled(0)(), unknown, NOWHERE)


def test_a_column_is_drivable_only_with_a_way_and_without_a_wall() -> None:
    """Truth T, prediction T under a wall; and a column whose wall is not evaluated."""
    truth, prediction, is_evaluated = filled(0)(), filled(0)(), EVERYWHERE.copy()
    truth[128, 128, 4] = truth[10, 10, 4] = prediction[128, 128, 4] = prediction[10, 10, 4] = 1
    prediction[128, 128, 9] = prediction[10, 10, 9] = 3
    is_evaluated[10, 10, 9] = False
    bev = frame_counts(prediction, truth_planes(truth, is_evaluated)).bev
    np.testing.assert_array_equal(bev, [[0, 1, 0], [0, 0, 0], [1, 0, 0]])
    holds(truth, prediction, is_evaluated)
