"""The plane of the ground around the robot: found among walls and grass, refused where it is not seen all around."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stone.geometry.se3 import SE3
from stone.sensors.ground_plane import GroundFit, ground_fit
from stone.sensors.ground_points import plane_around


def ground(height_m=0.0, slope_x=0.0, slope_y=0.0, noise_m=0.02, seed=0, sides=(-10.0, 10.0)):
    rng = np.random.default_rng(seed)
    plan = rng.uniform(*sides, (20_000, 2))
    z = height_m + plan @ [slope_x, slope_y] + noise_m * rng.standard_normal(len(plan))
    return np.column_stack([plan, z]).astype(np.float32)


def wall(seed=1):
    rng = np.random.default_rng(seed)
    return rng.uniform([1.5, -8.0, -0.2], [1.8, 8.0, 1.4], (8_000, 3)).astype(np.float32)


def grass(seed=2):
    """Blades up to 0.4 m on half of what is around."""
    rng = np.random.default_rng(seed)
    return rng.uniform([-6.0, 0.0, 0.0], [6.0, 6.0, 0.4], (4_000, 3)).astype(np.float32)


@given(st.floats(-0.6, 0.6), st.floats(-0.12, 0.12), st.floats(-0.12, 0.12), st.integers(0, 100))
def test_a_plane_is_found_to_two_centimetres_and_a_third_of_a_degree(height_m, slope_x, slope_y, seed):
    found = plane_around(ground(height_m, slope_x, slope_y, seed=seed))
    assert found is not None
    assert found[0] == pytest.approx(height_m, abs=0.02)
    assert found[1:] == pytest.approx([slope_x, slope_y], abs=0.006)


@pytest.mark.parametrize("clutter", [wall(), grass()], ids=["wall", "grass"])
def test_what_stands_on_the_ground_is_not_taken_for_it(clutter):
    found = plane_around(np.concatenate([ground(-0.3), clutter]))
    assert found is not None
    assert found[0] == pytest.approx(-0.3, abs=0.03)


@pytest.mark.parametrize(
    "points",
    [
        np.zeros((0, 3), np.float32),
        ground(sides=(1.0, 6.0)),
        wall(),
        np.full((5_000, 3), np.nan, np.float32),
        np.random.default_rng(3).uniform([-6, -6, -2], [6, 6, 1.4], (500, 3)).astype(np.float32),
    ],
    ids=["nothing", "one side", "a wall", "no numbers", "rain"],
)
def test_what_is_no_ground_all_around_gives_none(points):
    assert plane_around(points) is None


def test_a_run_is_told_by_the_middle_of_its_sweeps():
    planes = [np.array([0.02 * number, 0.0, 0.01]) for number in range(-4, 5)] + [np.array([3.0, 0.3, 0.3])]
    fit = ground_fit(planes)
    assert fit is not None
    assert fit.sweeps == 10
    assert fit.height_m == pytest.approx(0.01, abs=0.02)
    assert (fit.slope_x, fit.slope_y) == pytest.approx((0.0, 0.01))
    assert ground_fit(planes[:4]) is None


@pytest.mark.parametrize(("height_m", "slope_x", "slope_y"), [(-0.23, 0.0, 0.0), (0.5, 0.05, -0.04), (0.0, 0.0, 0.06)])
def test_with_the_corrected_mount_the_ground_is_where_it_should_be(height_m, slope_x, slope_y):
    mount = SE3.from_parts(np.array([0.99, 0.02, -0.03, 0.1]), np.array([0.3, -0.1, 1.6]))
    fit = GroundFit(40, height_m, slope_x, slope_y, height_m, height_m)
    seen_lidar = mount.inverse() @ ground(height_m, slope_x, slope_y).astype(np.float64)
    found = plane_around((fit.corrected(mount) @ seen_lidar).astype(np.float32))
    assert found is not None
    assert np.abs(found) == pytest.approx(np.zeros(3), abs=0.02)


@pytest.mark.parametrize("heading_rad", [0.0, 1.5, -2.5])
def test_a_corrected_mount_stays_where_it_was_in_plan_and_looks_where_it_looked(heading_rad):
    wxyz = np.array([np.cos(heading_rad / 2), 0.01, -0.02, np.sin(heading_rad / 2)])
    mount = SE3.from_parts(wxyz, np.array([0.3, -0.1, 1.6]))
    right = GroundFit(40, 0.4, 0.05, -0.04, 0.4, 0.4).corrected(mount)
    assert right.translation_m[:2].tolist() == [0.3, -0.1]
    ahead, ahead_before = (one.rotation()[:2, 0] for one in (right, mount))
    assert np.arctan2(*ahead[::-1]) == pytest.approx(np.arctan2(*ahead_before[::-1]), abs=1e-9)


def test_a_mount_that_looks_up_is_turned_as_little_as_can_be():
    """Its x axis has no heading in plan."""
    mount = SE3.from_parts(np.array([np.sqrt(0.5), 0.0, -np.sqrt(0.5), 0.0]), np.array([0.0, 0.0, 1.0]))
    right = GroundFit(40, 0.0, 0.05, 0.0, 0.0, 0.0).corrected(mount)
    turned = right @ mount.inverse()
    assert 2 * np.linalg.norm(turned.wxyz[1:]) == pytest.approx(np.arctan(0.05), rel=0.01)


def test_what_stands_close_beside_the_robot_is_not_its_ground():
    """Two cars beside it fill little of the plan around it, and lie nearer than the road that the LiDAR sees."""
    rng = np.random.default_rng(3)
    road = np.column_stack([rng.uniform(-9, 9, (60_000, 2)), rng.normal(0.0, 0.01, 60_000)])
    road = road[np.hypot(road[:, 0], road[:, 1]) > 4.0]
    cars = np.column_stack([rng.uniform(-1.5, 1.5, 3000), rng.uniform(2.0, 2.5, 3000), rng.normal(0.9, 0.01, 3000)])
    behind = cars * np.array([1.0, -1.0, 1.0])
    found = plane_around(np.concatenate([road, cars, behind]).astype(np.float32))
    assert found is not None
    assert np.abs(found) == pytest.approx(np.zeros(3), abs=0.02)


def test_terrain_is_not_corrected_away():
    assert GroundFit(40, 0.05, 0.02, 0.0, 0.0, 0.1).beyond_terrain() == GroundFit(40, 0.0, 0.0, 0.0, 0.0, 0.1)
    assert GroundFit(40, 0.23, 0.02, 0.0, 0.2, 0.3).beyond_terrain() == GroundFit(40, 0.23, 0.0, 0.0, 0.2, 0.3)
    assert GroundFit(40, 0.05, 0.06, 0.0, 0.0, 0.1).beyond_terrain() == GroundFit(40, 0.0, 0.06, 0.0, 0.0, 0.1)
