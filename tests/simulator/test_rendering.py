"""Light and shade: closed-form places, seen by single rays."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from simulator.appearance import renderer as rendering
from simulator.appearance.lights import LIGHTS
from simulator.scenery.movers import Mover, Vehicle, Walker
from simulator.scenery.path import DriveTrajectory
from simulator.scenery.route import Route, Schedule
from simulator.scenery.world import START_NS
from stone.splits.surroundings import DAYLIGHT, ILLUMINATIONS
from tests.simulator.stage import CENTRE_M, WALL_AHEAD_M, WALL_TOP_M, looking_at, renderer, stage

ABOVE_M = np.array([0.0, 0.0, 6.0])


class FlatGround:
    def elevation_m(self, xy: np.ndarray) -> np.ndarray:
        return np.zeros(xy.shape[:-1])


def ground_points(x_m: tuple[float, float], y_m: tuple[float, float], count: int = 400) -> np.ndarray:
    """Scattered over a rectangle about the robot."""
    xy = np.random.default_rng(4).uniform((x_m[0], y_m[0]), (x_m[1], y_m[1]), (count, 2))
    return CENTRE_M + np.concatenate([xy, np.zeros((count, 1))], axis=1)


def walker_beside(trajectory: DriveTrajectory) -> tuple[Mover, ...]:
    return (Walker(Route(trajectory, FlatGround(), Schedule(0.0), aside_m=3.0)),)


def vehicle_beside(trajectory: DriveTrajectory) -> tuple[Mover, ...]:
    return (Vehicle(Route(trajectory, FlatGround(), Schedule(0.0), aside_m=3.0)),)


def seen_from_above(points: np.ndarray, illumination: str = "day", **of_stage) -> np.ndarray:
    return renderer(stage(**of_stage), illumination).pixels(looking_at(points, points + ABOVE_M)).astype(int)


def test_a_place_has_one_colour_from_two_sides() -> None:
    points = ground_points((-6, 4), (-6, 6))
    aside = np.array([1.5, 0.5, 2.0])
    one, other = (
        renderer(stage(), "overcast").pixels(looking_at(points, points + way)).astype(int)
        for way in (aside, aside * (-1, -1, 1))
    )
    assert np.abs(one - other).max() <= 3
    assert one.std(axis=0).min() > 3


def test_a_wall_shades_the_ground_as_far_as_its_height_over_the_tangent_of_the_suns_elevation() -> None:
    """Moving the wall by the length of its shade takes the shade away; the ground keeps its texture."""
    sun = LIGHTS["day"].towards
    far_m = WALL_TOP_M * sun[0] / sun[2]  # along x, away from the sun
    assert far_m > 0.5
    behind = WALL_AHEAD_M - 0.15
    shaded, lit = (
        ground_points((behind - far_m + 0.1, behind - 0.1), (-1, 1)),
        ground_points((2, behind - far_m - 0.1), (-1, 1)),
    )
    away = WALL_AHEAD_M + 8
    assert np.all(seen_from_above(shaded).sum(axis=1) < 0.8 * seen_from_above(shaded, wall_ahead_m=away).sum(axis=1))
    np.testing.assert_array_equal(seen_from_above(lit), seen_from_above(lit, wall_ahead_m=away))


@pytest.mark.parametrize("movers", [walker_beside, vehicle_beside])
def test_what_moves_casts_shade(movers) -> None:
    sun = LIGHTS["day"].towards
    foot = np.array([0.0, 3.0, 0.0])
    middle = foot - 1.2 * sun / sun[2]  # below the shade of its axis at 1.2 m
    points = CENTRE_M + (middle + np.random.default_rng(5).uniform(-0.05, 0.05, (50, 3))) * (1, 1, 0)
    origins = points + np.array([-0.4, 3.0, 1.0])
    with_it, without = (
        renderer(stage(movers=who)).pixels(looking_at(points, origins)).astype(int) for who in (movers, lambda _: ())
    )
    assert with_it.sum() < 0.85 * without.sum()


def test_normals_of_movers_point_outwards() -> None:
    trajectory = stage().trajectory
    (walker,), (vehicle,) = walker_beside(trajectory), vehicle_beside(trajectory)
    foot = CENTRE_M + np.array([0, 3, 0])
    np.testing.assert_allclose(walker.normals(foot[None] + (0.25, 0, 1.0), START_NS), [[1, 0, 0]], atol=1e-6)
    faces = np.array([[2.1, 0.3, 1.0], [-2.1, 0.3, 1.0], [0.5, 0.9, 1.0], [0.5, -0.9, 1.0], [0.5, 0.3, 1.6]])
    expected = [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1]]
    np.testing.assert_allclose(vehicle.normals(foot + faces, START_NS), expected, atol=1e-6)


def test_every_word_for_the_light_has_one_and_nights_are_darker_than_days() -> None:
    assert set(LIGHTS) == set(ILLUMINATIONS)
    points = ground_points((-6, 4), (-6, 6), 200)
    brightness = {word: seen_from_above(points, word).mean() for word in ILLUMINATIONS}
    days = [value for word, value in brightness.items() if DAYLIGHT[word] == "day"]
    nights = [value for word, value in brightness.items() if DAYLIGHT[word] == "night"]
    assert max(nights) < min(days)
    assert brightness["night"] < brightness["moonlit"] < brightness["floodlit"]


def test_at_night_the_lamps_light_what_is_near() -> None:
    lamps = np.array([[*(CENTRE_M + np.array([0, 0, 1.0])), 1.0, 0, 0, LIGHTS["night"].lamp]])
    rows = [ground_points((x, x + 0.5), (-0.5, 0.5), 100) for x in (1.5, 3, 5.0, -4.0)]
    from_robot = [looking_at(row, np.tile(CENTRE_M + np.array([0, 0, 1.0]), (100, 1))) for row in rows]
    seen = renderer(stage(), "night")
    two, three, five, behind = (seen.pixels(replace(view, lamps=lamps)).mean() for view in from_robot)
    assert two > three > five > 2 * behind


def test_pieces_change_no_pixel_and_bound_the_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    seen, points = renderer(stage()), ground_points((-10, 10), (-10, 10), 24_000)
    view = looking_at(points, points + ABOVE_M)
    whole = seen.pixels(view)
    monkeypatch.setattr(rendering, "PIECE_RAYS", 3000)
    np.testing.assert_array_equal(seen.pixels(view), whole)
    peaks = [_peak_bytes(lambda count=count: seen.pixels(view.of(slice(count)))) for count in (6000, 24_000)]
    assert peaks[1] < 1.3 * peaks[0]


def _peak_bytes(run) -> int:
    tracemalloc.start()
    run()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


def test_the_sky_is_above_the_horizon_only_and_brightest_round_the_sun() -> None:
    sun = LIGHTS["sunny"].towards
    ways = np.array([sun, sun * (-1, -1, 1), [0.6, 0.6, 0.05], [0.6, 0.6, -0.2]])
    eyes = np.tile(CENTRE_M + np.array([0, 0, 1.5]), (4, 1))
    at_sun, away, low, ground = renderer(stage(), "sunny").pixels(looking_at(eyes + ways, eyes)).astype(int)
    assert at_sun.min() > 250
    assert away[2] > away[0] + 20  # blue
    assert ground[1] > ground[2] + 10  # grass
    assert low.min() > 150
