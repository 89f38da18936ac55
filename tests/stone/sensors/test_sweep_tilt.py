"""A LiDAR that is tilted shows in looks at the same ground from two places, and terrain does not."""

import numpy as np
import pytest

from stone.geometry.se3 import SE3
from stone.sensors.ground_links import Way, driven, links_between, look
from stone.sensors.ground_plane import GroundFit
from stone.sensors.sweep_tilt import sweep_tilt

X = np.arange(0.0, 40.0, 2.0)
WINDING = np.column_stack([X, 4 * np.sin(X / 6)])
STRAIGHT = np.column_stack([X, 0 * X])


def found_on(plan, slopes, drift=0.0, steep=0.1):
    """The tilt by looks along a way over a hillside with bumps; `slopes` are what the sweeps show too much."""
    rng, yaws = np.random.default_rng(2), np.arctan2(*np.gradient(plan, axis=0).T[::-1])
    way, looks = Way(plan, driven(plan), np.zeros(len(plan), np.int64)), []
    for place, yaw, driven_m in zip(plan, yaws, way.driven_m, strict=True):
        seen = rng.uniform(-9, 9, (5000, 2))
        turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        points = place + seen @ turn.T
        heights = steep * points[:, 0] - 0.08 * points[:, 1] + 0.15 * np.sin(points).sum(axis=1)
        noise = rng.normal(0, 0.02, len(points))
        looks.append(look(np.column_stack([points, heights + seen @ slopes + drift * driven_m + noise])))
    wxyz = np.column_stack([np.cos(yaws / 2), 0 * yaws, 0 * yaws, np.sin(yaws / 2)])
    poses = SE3.from_parts(wxyz, np.column_stack([plan, 0 * yaws]))
    return sweep_tilt(links_between(looks, way), way, poses)


@pytest.mark.parametrize("slopes", [(0.0, 0.0), (0.035, 0.0), (-0.01, 0.02), (0.0, -0.035)])
def test_the_tilt_is_found_over_a_hillside_with_bumps(slopes):
    tilt = found_on(WINDING, np.array(slopes))
    assert tilt.slope_x == pytest.approx(slopes[0], abs=0.002)
    assert tilt.slope_y == pytest.approx(slopes[1], abs=0.008)
    assert tilt.error_x < 0.002


def test_poses_that_climb_look_like_a_tilt_along_and_a_straight_way_shows_none_across():
    tilt = found_on(STRAIGHT, np.array([0.0, 0.035]), drift=0.01)
    assert tilt.slope_x == pytest.approx(-0.01, abs=0.002)
    assert tilt.error_y > 10 * tilt.error_x
    assert tilt.error_y > 0.02


TWO = 0.035


@pytest.mark.parametrize(
    ("slopes", "in_map", "claims"),
    [
        ((TWO, 0.0), (TWO, 0.0), {"is_mount_tilted", "is_map_tilted", "is_tilted"}),
        ((0.0, -TWO), (0.0, -TWO), {"is_mount_tilted", "is_map_tilted", "is_tilted"}),
        ((0.0, 0.0), (TWO, 0.0), {"is_way_tilted", "is_map_tilted"}),
        ((TWO, 0.0), (0.0, 0.0), {"is_body_pitched", "is_tilted"}),
        ((0.0, TWO), (0.0, 0.002), {"is_tilted"}),  # the body leans, or the road does
        ((0.0, TWO), (0.0, -TWO), {"is_tilted"}),  # noise
        ((TWO, TWO), (None, None), {"is_map_tilted", "is_tilted"}),  # not known: nothing is refused
        ((0.005, 0.02), (0.008, 0.015), {"is_map_tilted"}),  # as sound drives have it
        ((0.0, 0.0), (-0.0115, 0.0), {"is_map_tilted"}),  # heights that drift by 1 %
    ],
)
def test_mount_poses_and_body_are_told_apart(slopes, in_map, claims):
    names = ("is_mount_tilted", "is_way_tilted", "is_body_pitched", "is_map_tilted", "is_tilted")
    fit = GroundFit(40, 0.0, *slopes, -0.1, 0.1, *in_map)
    assert {name for name in names if getattr(fit, name)} == claims
