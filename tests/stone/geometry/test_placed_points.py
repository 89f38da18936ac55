"""Points are placed by a pose as the pose itself places them."""

import numpy as np
import pytest
from hypothesis import given, settings

from stone.geometry.placed_points import placed
from stone.geometry.se3 import SE3
from tests.stone.geometry.test_se3 import transforms


@settings(max_examples=60, deadline=None)
@given(transforms(batch=()))
def test_every_bit_is_that_of_the_pose_applied(pose: SE3) -> None:
    points = np.random.default_rng(3).normal(0.0, 20.0, (257, 3))
    points[0], points[1, 1] = 0.0, np.nan
    assert placed(pose, points).tobytes() == (pose @ points).tobytes()


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.arange(12.0).reshape(2, 6)[:, ::2], np.ones((3, 4)).T[:, :3]])
def test_no_points_and_points_that_do_not_lie_in_a_row(points: np.ndarray) -> None:
    pose = SE3(np.array([0.5, 0.5, -0.5, 0.5, 1.0, 2.0, 3.0]))
    assert (placed(pose, points) == pose @ points).all()
