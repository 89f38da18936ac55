"""The kernels and the ratios against the slow metric and a plain histogram; planes come back from their runs."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from stone.errors import ShapeError
from stone.labels.grid import Grid
from stone.scoring.bitplanes import frame_counts, truth_planes
from stone.scoring.confusion import extras, named_ratios, tolerant_ratios
from stone.scoring.frame_counts import LabelRangeError, Planes
from stone.scoring.metric import METRICS, RATIOS
from stone.scoring.plane_layout import RINGS, column_rings, layout_of
from stone.scoring.plane_runs import PlaneRuns, planes_of, runs_of
from stone_base.label_grid import OCC3D, PAPER, RELEASE, LabelGrid
from tests.plain_confusion import confusion_matrix
from tests.slow_metric import (
    Counts,
    added,
    added_columns,
    slow_counts,
    slow_extras,
    slow_ratios,
    slow_tolerant,
)

Mask = NDArray[np.bool_]
COLUMNS, WORDS = 256 * 256, 256 * 128
# Grids whose columns are shorter than a word, and one that lies ahead of the robot: its rings are odd.
FORWARD = LabelGrid("forward", (2.0, -3.7, -1.0), 0.2, (136, 72, 8))
GRIDS = [RELEASE, OCC3D, FORWARD, LabelGrid("coarse", (-40.0, -44.8, -2.4), 0.8, (112, 104, 8))]
EVERYWHERE, NOWHERE = np.ones(PAPER.shape, np.bool_), np.zeros(PAPER.shape, np.bool_)


def scattered(seed: int, columns: int, classes: tuple[int, ...]) -> Grid:
    """Labels of these classes in this many columns, some of them in the outermost."""
    rng = np.random.default_rng(seed)
    grid = np.zeros(PAPER.shape, np.uint8)
    x, y = (np.append(rng.integers(0, 256, columns), [0, 255]) for _ in range(2))
    grid[x, y] = rng.choice([0, *classes], (columns + 2, 32)).astype(np.uint8)
    return grid


def holds(truth: Grid, prediction: Grid, is_evaluated: Mask) -> None:
    """Everything about a frame is what the slow metric says."""
    found, slow = (
        frame_counts(prediction, truth_planes(truth, is_evaluated)),
        slow_counts(truth, prediction, is_evaluated),
    )
    by_column = found.column_counts
    arrays = (found.confusion, found.bev, by_column.pairs, by_column.columns)
    assert Counts(*(array.tolist() for array in arrays)) == slow
    cells, columns = added([slow])
    total, bev, pairs, clear = (array.sum(axis=0) for array in arrays)
    assert vars(extras(total, bev, clear)) == slow_extras(cells, columns, added_columns([slow]))
    read = [(named_ratios(total, metric), slow_ratios(cells, metric)) for metric in METRICS]
    for named, expected in [*read, (tolerant_ratios(total, pairs), slow_tolerant([slow]))]:
        assert [named[name] is None for name in RATIOS] == [expected[name] is None for name in RATIOS]
        assert [named[name] or 0 for name in RATIOS] == pytest.approx(
            [expected[name] or 0 for name in RATIOS], rel=1e-15
        )


CLASSES = st.lists(st.sampled_from([1, 2, 3]), unique=True, max_size=3).map(tuple)


@pytest.mark.whole
@settings(max_examples=4, deadline=None)
@given(st.integers(0, 2**32 - 1), CLASSES, CLASSES, st.floats(0, 1))
def test_random_grids_count_as_the_slow_metric_counts(
    seed: int, true: tuple[int, ...], predicted: tuple[int, ...], evaluated_ratio: float
) -> None:
    rng = np.random.default_rng(seed)
    truth, prediction = scattered(seed, 2000, true), scattered(seed // 2, 2000, predicted)
    holds(truth, prediction, rng.random(PAPER.shape, np.float32) < evaluated_ratio)


@pytest.mark.parametrize("grid", GRIDS, ids=lambda grid: grid.name)
@pytest.mark.parametrize(("occupied_ratio", "evaluated_ratio"), [(0.02, 1.0), (0.4, 0.6)])
def test_every_grid_counts_as_the_slow_metric_counts(
    grid: LabelGrid, occupied_ratio: float, evaluated_ratio: float
) -> None:
    rng = np.random.default_rng(grid.voxels)
    truth, prediction = (
        np.where(rng.random(grid.shape) < occupied_ratio, rng.integers(0, 4, grid.shape), 0).astype(np.uint8)
        for _ in range(2)
    )
    is_evaluated = rng.random(grid.shape) < evaluated_ratio
    place = tuple(round(1000 * length_m) for length_m in (*grid.min_m[:2], grid.voxel_m))
    slow = slow_counts(truth, prediction, is_evaluated, place)  # type: ignore[arg-type]
    found = frame_counts(prediction, truth_planes(truth, is_evaluated, grid))
    by_column = found.column_counts
    arrays = (found.confusion, found.bev, by_column.pairs, by_column.columns)
    assert Counts(*(array.tolist() for array in arrays)) == slow
    assert sum(map(sum, slow.columns[0])) > 0
    planes = truth_planes(truth, is_evaluated, grid).planes
    np.testing.assert_array_equal(planes_of(runs_of(planes)), planes)


@pytest.mark.parametrize("grid", GRIDS, ids=lambda grid: grid.name)
def test_labels_of_another_grid_are_refused(grid: LabelGrid) -> None:
    truth = truth_planes(np.zeros(grid.shape, np.uint8), np.ones(grid.shape, np.bool_), grid)
    with pytest.raises(ShapeError):
        frame_counts(np.zeros(PAPER.shape, np.uint8), truth)
    beyond = np.zeros(grid.shape, np.uint8)
    beyond[-1, -1, -1] = 255
    with pytest.raises(LabelRangeError):
        frame_counts(beyond, truth)


def filled(label: int) -> Callable[[], Grid]:
    return lambda: np.full(PAPER.shape, label, np.uint8)


@pytest.mark.whole
@pytest.mark.parametrize("truth", [filled(0), filled(3), lambda: scattered(1, 900, (1, 2))])
@pytest.mark.parametrize("prediction", [filled(0), filled(1), lambda: scattered(2, 900, (1, 2))])
@pytest.mark.parametrize("is_evaluated", [EVERYWHERE, NOWHERE], ids=["everywhere", "nowhere"])
def test_edge_grids_count_as_the_slow_metric_counts(
    truth: Callable[[], Grid], prediction: Callable[[], Grid], is_evaluated: Mask
) -> None:
    holds(truth(), prediction(), is_evaluated)


def test_a_column_is_drivable_only_with_a_way_and_without_a_wall() -> None:
    """Truth T, prediction T under a wall; and a column whose wall is not evaluated."""
    truth, prediction, is_evaluated = filled(0)(), filled(0)(), EVERYWHERE.copy()
    truth[128, 128, 4] = truth[10, 10, 4] = prediction[128, 128, 4] = prediction[10, 10, 4] = 1
    prediction[128, 128, 9] = prediction[10, 10, 9] = 3
    is_evaluated[10, 10, 9] = False
    bev = frame_counts(prediction, truth_planes(truth, is_evaluated)).bev
    np.testing.assert_array_equal(bev, [[0, 1, 0], [0, 0, 0], [1, 0, 0]])
    holds(truth, prediction, is_evaluated)


@pytest.mark.parametrize(
    ("truth", "prediction", "pairs"),
    [
        ({5: 1}, {6: 1}, (1, 1, 0, 0)),  # one too high
        ({5: 1}, {7: 1}, (0, 0, 0, 0)),  # two too high
        ({5: 1}, {6: 2}, (1, 0, 0, 0)),
        ({5: 1}, {4: 1, 5: 1, 6: 1}, (1, 1, 0, 0)),  # thickness earns nothing
        ({z: 3 for z in range(4, 14)}, {z: 3 for z in range(5, 15)}, (10, 0, 0, 10)),
        ({31: 2, 0: 3}, {30: 2, 1: 3}, (2, 0, 1, 1)),
        ({31: 2}, {0: 2}, (0, 0, 0, 0)),
    ],
)
def test_voxels_pair_with_those_at_most_one_voxel_above_or_below(
    truth: dict[int, int], prediction: dict[int, int], pairs: tuple[int, ...]
) -> None:
    """Of two neighbouring columns, so that nothing pairs across their border."""
    for column in ((128, 128), (128, 129)):
        counts = frame_counts(standing(column, prediction), truth_planes(standing(column, truth), EVERYWHERE))
        assert tuple(counts.column_counts.pairs[0].tolist()) == pairs


@pytest.mark.parametrize(
    ("labels", "expected"),
    [
        ({}, 0),
        ({5: 1}, 1),
        ({5: 1, 6: 2}, 2),
        ({5: 1, 6: 3}, 3),
        ({5: 2, 13: 3}, 3),  # 1.4 m to drive under
        ({5: 2, 14: 3}, 2),  # 1.6 m
        ({5: 2, 14: 3, 4: 3}, 3),
        ({0: 1, 31: 3}, 1),
        ({20: 3}, 3),
        ({23: 1, 31: 3}, 3),
        ({31: 1}, 1),
    ],
)
def test_a_column_is_of_its_worst_class_under_the_robots_height(labels: dict[int, int], expected: int) -> None:
    column = (0, 255)
    counts = frame_counts(standing(column, labels), truth_planes(standing(column, labels), EVERYWHERE))
    found = counts.column_counts.columns.sum(axis=0)
    assert found[expected, expected] == (COLUMNS if expected == 0 else 1)
    assert found.sum() == COLUMNS


def standing(column: tuple[int, int], labels: dict[int, int]) -> Grid:
    grid = filled(0)()
    for z, label in labels.items():
        grid[*column, z] = label
    return grid


def random_grid(seed: int, occupied_ratio: float) -> Grid:
    rng = np.random.default_rng(seed)
    is_occupied = rng.random(PAPER.shape, dtype=np.float32) < occupied_ratio
    return np.where(is_occupied, rng.integers(0, 4, PAPER.shape), 0).astype(np.uint8)


@settings(max_examples=4, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0, 1), st.floats(0, 1))
def test_each_ring_counts_as_a_histogram_does(seed: int, occupied_ratio: float, evaluated_ratio: float) -> None:
    truth, prediction = random_grid(seed, occupied_ratio), random_grid(seed + 1, 1 - occupied_ratio)
    is_evaluated = np.random.default_rng(seed + 2).random(PAPER.shape, dtype=np.float32) < evaluated_ratio
    counted = frame_counts(prediction, truth_planes(truth, is_evaluated)).confusion
    assert counted.dtype == np.int32
    rings = column_rings().reshape(*PAPER.shape[:2], 1)
    for ring in range(RINGS):
        np.testing.assert_array_equal(
            counted[ring], confusion_matrix(truth, prediction, is_evaluated & (rings == ring))
        )


def test_the_planes_of_the_papers_grid_have_a_place_for_each_column() -> None:
    assert layout_of(PAPER).words == WORDS


def test_a_column_lies_in_the_ring_of_its_distance_from_the_robot() -> None:
    rings = column_rings().reshape(PAPER.shape[:2])
    for x, y in [(128, 128), (128, 177), (128, 178), (177, 128), (178, 128), (128, 227), (128, 228), (0, 0), (92, 163)]:
        distance_m = ((x * 0.2 - 25.5) ** 2 + (y * 0.2 - 25.5) ** 2) ** 0.5
        assert rings[x, y] == (distance_m >= 10) + (distance_m >= 20)
    assert np.bincount(rings.ravel()).sum() == COLUMNS


def test_a_value_above_three_is_refused_even_where_nothing_is_evaluated() -> None:
    nothing = truth_planes(np.zeros(PAPER.shape, np.uint8), np.zeros(PAPER.shape, np.bool_))
    for value in (4, 128, 255):
        grid = np.zeros(PAPER.shape, np.uint8)
        grid[200, 17, 31] = value
        with pytest.raises(LabelRangeError):
            frame_counts(grid, nothing)


def test_other_shapes_and_types_are_refused() -> None:
    everywhere = np.ones(PAPER.shape, np.bool_)
    for truth, is_evaluated in (
        (np.zeros((32, 256, 256), np.uint8), everywhere),
        (np.zeros(PAPER.shape, np.int64), everywhere),
        (np.zeros(PAPER.shape, np.uint8), everywhere[:1]),
    ):
        with pytest.raises(ShapeError):
            truth_planes(truth, is_evaluated)


def test_memory_order_does_not_matter() -> None:
    truth, prediction = random_grid(1, 0.3), random_grid(2, 0.3)
    planes = truth_planes(truth, np.ones(PAPER.shape, np.bool_))
    same = frame_counts(np.asfortranarray(prediction), planes)
    np.testing.assert_array_equal(same.confusion, frame_counts(prediction, planes).confusion)
    np.testing.assert_array_equal(same.bev, frame_counts(prediction, planes).bev)


def patchy(seed: int, change_ratio: float) -> Planes:
    """Planes whose columns change at about this share of places."""
    rng = np.random.default_rng(seed)
    values = rng.integers(0, 2**32, 3 * COLUMNS, np.uint32)
    starts = np.maximum.accumulate(np.where(rng.random(3 * COLUMNS) < change_ratio, np.arange(3 * COLUMNS), 0))
    return values[starts].view(np.uint64).reshape(3, WORDS)


@settings(max_examples=6, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0, 1))
def test_planes_come_back_as_they_were(seed: int, change_ratio: float) -> None:
    planes = patchy(seed, change_ratio)
    runs = runs_of(planes)
    np.testing.assert_array_equal(planes_of(runs), planes)
    flat = planes.view(np.uint32).reshape(-1).tolist()
    assert len(runs.columns) == 1 + sum(here != before for before, here in pairwise(flat))


@pytest.mark.parametrize("word", [0, 2**64 - 1])
def test_planes_that_are_all_alike_are_one_run(word: int) -> None:
    runs = runs_of(np.full((3, WORDS), word, np.uint64))
    assert len(runs.columns) == 1
    assert (planes_of(runs) == np.uint64(word)).all()


def test_runs_that_do_not_fit_are_refused_before_anything_is_read() -> None:
    runs = runs_of(patchy(0, 0.1))
    first = runs.changes.copy()
    first[0] &= ~np.uint64(1)
    everywhere = np.full(3 * COLUMNS // 64, 2**64 - 1, np.uint64)
    for wrong in (
        PlaneRuns(everywhere, runs.columns),
        replace(runs, columns=runs.columns[1:]),
        replace(runs, changes=first),
        replace(runs, changes=runs.changes[:-1]),
    ):
        with pytest.raises(ShapeError):
            planes_of(wrong)
    with pytest.raises(ShapeError):
        runs_of(np.zeros((2, WORDS), np.uint64))
