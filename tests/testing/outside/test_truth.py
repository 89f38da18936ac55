"""The truth of an analytic world at places whose answer is known."""

import numpy as np
import pytest

from testing.outside.truth import AIR, DRIVABLE, GREY, OBSTACLE
from tests.testing.outside.places import known_truth

pytestmark = pytest.mark.whole


@pytest.mark.parametrize(
    ("name", "point", "code", "thing"),
    [
        ("level ground", (0.0, 0.0, 0.0), DRIVABLE, ""),
        ("a voxel above it", (0.0, 0.0, 0.2), DRIVABLE, ""),
        ("air", (0.0, 0.0, 0.6), AIR, ""),
        ("the mound at 12.5°", (0.0, 20.0 - 7.3, 0.7 * np.tan(np.deg2rad(12.5))), DRIVABLE, ""),
        ("the mound at 30°", (0.0, 20.0 - 2.9, 1.8), OBSTACLE, "mound"),
        ("a flank of the ditch", (0.0, -10.6, -0.4), OBSTACLE, "ditch"),
        ("the floor of the ditch", (0.0, -10.0, -0.7), GREY, ""),
        ("the face of the bank", (0.0, -20.0, 0.15), OBSTACLE, "bank"),
        ("a step before the bank", (0.0, -20.3, 0.0), GREY, ""),
        ("behind the bank", (0.0, -18.5, 0.26), DRIVABLE, ""),
        ("the trunk", (10.2, 10.0, 1.0), OBSTACLE, "trunk"),
        ("the trunk near its foot", (10.2, 10.0, 0.3), OBSTACLE, "trunk"),
        ("the trunk over the robot", (10.2, 10.0, 2.0), GREY, ""),
        ("the foot of the trunk", (10.2, 10.0, 0.0), GREY, ""),
        ("the ground beside it", (11.0, 10.0, 0.0), DRIVABLE, ""),
        ("the crown", (10.0, 11.0, 3.5), GREY, ""),
        ("the ground under the roof", (20.0, 10.0, 0.0), DRIVABLE, ""),
        ("the bar", (15.0, -5.0, 0.7), OBSTACLE, "bar"),
        ("the ground under the bar", (15.0, -5.0, 0.0), GREY, ""),
        ("a small rock", (5.0, 5.0, 0.15), GREY, ""),
        ("a rock", (7.0, 5.0, 0.35), OBSTACLE, "rock"),
        ("the tips of grass", (20.0, -10.0, 0.35), DRIVABLE, ""),
    ],
)
def test_a_known_place_is_what_it_is(name: str, point: tuple[float, float, float], code: int, thing: str) -> None:
    judged = known_truth().judge(np.array([point]))
    number = int(judged.things[0])
    assert (judged.codes[0], known_truth().things[number] if number >= 0 else "") == (code, thing), name


def test_a_mounds_slope_is_read_to_half_a_degree() -> None:
    points = np.array([[0.0, 20.0 - away, 0.0] for away in (1.6, 2.9, 4.3, 5.75, 7.25)])
    points[:, 2] = [2.45, 1.60, 0.95, 0.45, 0.17]
    judged = known_truth().judge(points)
    np.testing.assert_allclose(judged.slope_deg, [42.0, 30.0, 22.5, 17.5, 12.5], atol=1.5)


def test_only_where_the_walker_went_is_it_its_way() -> None:
    place = known_truth().world.walker_at(np.array([3.0]))[0]
    points = np.array([[*place, 1.0], [*place, 0.2], [*(place + 1.5), 1.0]])
    assert known_truth().in_walkers_way(points).tolist() == [True, False, False]
