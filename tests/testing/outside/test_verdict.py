"""The judge of the analytic worlds on label grids made by hand."""

from collections import Counter

import numpy as np
import pytest

from testing.outside.truth import AIR, OBSTACLE
from testing.outside.verdict import GRID_MIN_M, N, P, T, Verdict, judge_frame, salt_voxels
from tests.testing.outside.places import known_truth

SHAPE = (256, 256, 32)

pytestmark = pytest.mark.whole


def index(point: tuple[float, float, float]) -> tuple[int, ...]:
    return tuple(np.floor((np.array(point) - GRID_MIN_M) / 0.2).astype(int))


def verdict_of(labels: dict[tuple[float, float, float], int], world_from_grid: np.ndarray | None = None) -> Verdict:
    grid, verdict = np.zeros(SHAPE, np.uint8), Verdict()
    for point, label in labels.items():
        grid[index(point)] = label
    judge_frame(grid, np.eye(4) if world_from_grid is None else world_from_grid, known_truth(), verdict)
    return verdict


TRUNK, ROCK, GROUND = (10.1, 10.1, 0.9), (7.1, 5.1, 0.3), (0.1, 0.1, 0.1)


def test_counts_are_those_of_hand() -> None:
    figures = verdict_of(
        {TRUNK: N, (10.1, 10.1, 1.1): P, ROCK: P, GROUND: T, (2.1, 0.1, 0.1): P, (4.1, 0.1, 0.1): P, (0.1, 8.1, 0.1): N}
    ).figures()
    assert figures["iou"] == 3 / 6
    assert figures["danger"] == 2 / 3
    assert figures["lost"] == 1 / 4
    assert (figures["danger trunk"], figures["missed trunk"]) == (1 / 2, 0.0)
    assert (figures["danger rock"], figures["missed rock"]) == (1.0, 1.0)
    assert (figures["missed"], figures["sighted"]) == (1 / 2, 2)
    assert figures["steep 0-10°"] == 3 / 4


def test_a_grid_is_placed_by_its_pose() -> None:
    pose = np.eye(4)
    pose[:3, 3] = (10.0, 10.0, 0.0)
    assert verdict_of({(0.1, 0.1, 0.9): N}, pose).figures()["missed trunk"] == 0.0


def test_nothing_labelled_has_no_ratio() -> None:
    figures = verdict_of({}).figures()
    assert (figures["iou"], figures["danger"], figures["lost"], figures["salt"]) == (None, None, None, 0.0)


@pytest.mark.parametrize(
    ("labels", "salt"),
    [
        ([((5, 5, 5), N), ((6, 6, 6), P)], 1),
        ([((5, 5, 5), N), ((6, 6, 6), N), ((7, 7, 7), N), ((8, 8, 8), T)], 3),
        ([((5, 5, 5), N), ((6, 6, 6), N), ((7, 7, 7), N), ((8, 8, 8), N), ((9, 9, 9), T)], 0),
        ([((5, 5, 5), N), ((8, 8, 8), P)], 0),
    ],
)
def test_salt_is_a_small_component_of_n_that_touches_what_is_free(
    labels: list[tuple[tuple[int, int, int], int]], salt: int
) -> None:
    grid = np.zeros(SHAPE, np.uint8)
    for place, label in labels:
        grid[place] = label
    codes = np.full(SHAPE, AIR, np.uint8)
    assert salt_voxels(grid, codes) == salt
    codes[5, 5, 5] = OBSTACLE
    assert salt_voxels(grid, codes) == 0


def test_counts_of_frames_add() -> None:
    one, other = verdict_of({TRUNK: N}), verdict_of({TRUNK: P})
    assert (one.counts + other.counts)["danger of:trunk"] == 2
    assert Verdict(2, Counter(one.counts) + other.counts).figures()["danger trunk"] == 1 / 2
