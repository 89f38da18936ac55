"""The baseline on closed-form worlds: a plane, a wall, a slope, nothing."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from stone.errors import ShapeError
from stone.labels.baseline import DEFAULTS, N, P, T, column_centres_m, ground_heights, predict_from_sweep
from stone_base.label_grid import PAPER, RELEASE

Points = NDArray[np.float32]
FLAT_LAYER = 10  # z = 0.05 m lies in [0, 0.2)


def sheet(slope_rad: float = 0.0, reach_m: float = 25.0, step_m: float = 0.15) -> Points:
    """A dense tilted plane through (0, 0, 0.05), rising with x."""
    axis = np.arange(-reach_m, reach_m, step_m) + 0.02  # off the borders of columns
    x, y = np.meshgrid(axis, axis, indexing="ij")
    return np.stack([x, y, 0.05 + math.tan(slope_rad) * x], axis=-1).reshape(-1, 3).astype(np.float32)


def test_flat_ground_is_one_closed_sheet_of_t_ahead_and_p_beside() -> None:
    grid = predict_from_sweep(sheet())
    assert set(np.unique(grid)) == {0, T, P}
    assert (grid[5:-5, 5:-5, FLAT_LAYER] > 0).all()
    assert (np.delete(grid, FLAT_LAYER, axis=2) == 0).all()
    x_m, y_m = column_centres_m()
    is_corridor = (np.abs(x_m) <= 15) & (np.abs(y_m) <= 0.425)
    np.testing.assert_array_equal(grid[..., FLAT_LAYER] == T, is_corridor)


def test_behind_the_robot_t_follows_the_track_that_it_drove() -> None:
    # A quarter circle of 10 m radius that ends at the robot, heading along x, and a place far outside the grid before.
    angle = np.linspace(-math.pi / 2, 0.0, 40)
    track = np.vstack([[-1e6, 1e6], np.column_stack([10 * np.sin(angle), 10 - 10 * np.cos(angle)])[:-1]])
    is_t = predict_from_sweep(sheet(), track_ego_m=track)[..., FLAT_LAYER] == T
    x_m, y_m = np.broadcast_arrays(*column_centres_m())
    is_ahead = (x_m >= 0) & (x_m <= 15) & (np.abs(y_m) <= 0.425)
    off_arc_m = np.abs(np.hypot(x_m, y_m - 10) - 10)
    is_behind = (x_m < 0) & (x_m > -10) & (y_m < 10)
    np.testing.assert_array_equal(is_t[is_ahead], True)
    assert is_t[is_behind & (off_arc_m < 0.40)].all()
    assert not is_t[is_behind & (off_arc_m > 0.45)].any()


@pytest.mark.parametrize(("slope_deg", "is_climbable"), [(10, True), (22, True), (28, False), (40, False)])
def test_a_slope_is_climbable_up_to_its_limit(slope_deg: float, is_climbable: bool) -> None:
    grid = predict_from_sweep(sheet(math.radians(slope_deg), reach_m=2.0, step_m=0.05))
    middle = grid[120:137, 120:137]
    assert set(np.unique(middle[middle > 0])) == ({T, P} if is_climbable else {N})


def test_a_wall_is_n_and_the_ground_before_it_is_not() -> None:
    y, z = np.meshgrid(np.arange(-3, 3, 0.05), np.arange(0.05, 2.0, 0.05), indexing="ij")
    wall = np.stack([np.full(y.shape, 5.1), y, z], axis=-1).reshape(-1, 3).astype(np.float32)
    grid = predict_from_sweep(np.concatenate([sheet(), wall]))
    column = grid[int((5.1 + 25.6) / 0.2), 128]
    assert (column[FLAT_LAYER + 3 : FLAT_LAYER + 9] == N).all()
    assert grid[int((3.1 + 25.6) / 0.2), 128, FLAT_LAYER] == T


def test_the_ground_under_the_robot_is_known_without_a_point() -> None:
    far = sheet()
    far = far[np.hypot(far[:, 0], far[:, 1]) > 1.5]
    assert predict_from_sweep(far)[128, 128, FLAT_LAYER] == T


def test_gaps_are_closed_from_neighbours_and_no_further() -> None:
    lowest = np.full(PAPER.shape[:2], np.inf, np.float32)
    lowest[10:12] = 0.5
    ground = ground_heights(lowest)
    assert ground[12:18, 40] == pytest.approx(0.5)
    assert np.isnan(ground[18:40, 40]).all()


def test_no_points_give_an_empty_grid() -> None:
    assert not predict_from_sweep(np.zeros((0, 3), np.float32)).any()


@settings(max_examples=30, deadline=None)
@given(hnp.arrays(np.float32, st.tuples(st.integers(0, 50), st.just(3)), elements=st.floats(width=32)))
def test_any_points_give_classes_and_every_measured_voxel_is_occupied(points: Points) -> None:
    grid = predict_from_sweep(points)
    assert grid.shape == PAPER.shape
    assert grid.dtype == np.uint8
    assert grid.max() <= N
    finite = points[np.isfinite(points).all(axis=1)].astype(np.float64)
    index = (finite - (-25.6, -25.6, -2.0)) / 0.2
    inside = ((index >= 1e-3) & (index < np.array(PAPER.shape) - 1e-3) & (np.abs(index % 1 - 0.5) < 0.499)).all(axis=1)
    assert (grid[tuple(index[inside].astype(int).T)] > 0).all()


def test_the_order_of_points_does_not_matter() -> None:
    points = sheet(0.2, reach_m=5.0)
    np.testing.assert_array_equal(predict_from_sweep(points), predict_from_sweep(points[::-1]))


def test_other_shapes_are_refused() -> None:
    with pytest.raises(ShapeError):
        predict_from_sweep(np.zeros((5, 4), np.float32))


def test_only_the_robots_own_footprint_is_known_without_a_point() -> None:
    lowest = np.full(PAPER.shape[:2], np.inf, np.float32)
    lowest[200:203, 128] = 0.05
    parameters = replace(DEFAULTS, gap_m=0.0, footprint_length_m=2.0, footprint_width_m=0.8)
    known_x, known_y = np.nonzero(np.isfinite(ground_heights(lowest, parameters))[:200])
    x_m, y_m = column_centres_m()
    assert np.abs(x_m[known_x]).max() == pytest.approx(0.9)
    assert np.abs(y_m[0, known_y]).max() == pytest.approx(0.3)
    assert len(known_x) == 10 * 4


def test_at_the_releases_grid_the_same_sweep_gives_the_same_ground():
    """Flat ground with a wall: each column's class is that of the paper's grid around the same place."""
    x, y = np.meshgrid(np.arange(-24, 24, 0.1), np.arange(-24, 24, 0.1))
    ground = np.stack([x.ravel(), y.ravel(), np.full(x.size, 0.02)], axis=1)
    wall = np.stack(np.meshgrid(np.arange(6, 6.4, 0.1), np.arange(-3, 3, 0.1), np.arange(0, 1.5, 0.1)), axis=-1)
    sweep = np.concatenate([ground, wall.reshape(-1, 3)]).astype(np.float32)
    fine, coarse = predict_from_sweep(sweep), predict_from_sweep(sweep, DEFAULTS, RELEASE)
    assert (fine.shape, coarse.shape) == (PAPER.shape, RELEASE.shape)
    for place in ((3.1, 0.1, 0.02), (-5.0, 4.9, 0.02), (10.1, -8.1, 0.02), (6.2, 0.2, 1.1)):
        found = []
        for grid, classes in ((PAPER, fine), (RELEASE, coarse)):
            i, j, k = np.floor((np.array(place) - grid.min_m) / grid.voxel_m).astype(int)
            found.append(int(classes[i, j, k]))
        assert found[0] == found[1] > 0
    assert (coarse > 0).sum() * 4 == pytest.approx((fine > 0).sum(), rel=0.1)
