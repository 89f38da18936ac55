"""Rays of the analytic worlds against hand algebra, and against the ground sampled densely."""

import numpy as np
import pytest

from testing.outside.casting import GROUND, NOTHING, Ceiling, cast
from testing.outside.ground import Array, Ground, heights_m
from testing.outside.solids import BOX, CYLINDER, ELLIPSOID, GRASS, Solid, as_rows
from tests.testing.outside.places import FLAT, SHAPED

WAVES = np.array([[0.5, 0.25, 0.1, 1.0], [0.1, 0.2, 0.6, 2.0]])


def ranges(ground: Ground, solids: list[Solid], rays: tuple[Array, Array], luck: float = 0.5) -> tuple[Array, Array]:
    count = len(rays[0])
    found = cast(
        rays, ground, Ceiling(ground, np.full(2, -60.0), np.full(2, 60.0)), as_rows(solids), np.full(count, luck)
    )
    return np.asarray(found[0]), np.asarray(found[1])


def along_x(height_m: float) -> tuple[Array, Array]:
    return np.array([[0.0, 0.0, height_m]]), np.array([[1.0, 0.0, 0.0]])


@pytest.mark.parametrize(
    ("solid", "height_m", "range_m"),
    [
        (Solid("rock", ELLIPSOID, (5, 0, 1.1), (1, 1, 1)), 1.1, 4.0),
        (Solid("rock", ELLIPSOID, (5, 0, 1.1), (1, 1, 1)), 1.7, 4.2),
        (Solid("rock", ELLIPSOID, (5, 0, 1.1), (1, 1, 1)), 2.2, np.inf),
        (Solid("trunk", CYLINDER, (5, 0.3, 1), (0.5, 0.5, 1)), 1.1, 4.6),
        (Solid("trunk", CYLINDER, (5, 0.3, 1), (0.5, 0.5, 1)), 2.1, np.inf),
        (Solid("wall", BOX, (5, 0, 1), (1, 1, 1), np.pi / 4), 1.1, 5 - np.sqrt(2)),
        (Solid("bar", BOX, (5, 0, 0.7), (0.06, 1, 0.1)), 0.7, 4.94),
        (Solid("bar", BOX, (5, 0, 0.7), (0.06, 1, 0.1)), 1.1, np.inf),
    ],
)
def test_a_solid_is_met_where_hand_algebra_says(solid: Solid, height_m: float, range_m: float) -> None:
    found, hit = ranges(FLAT, [solid], along_x(height_m))
    assert found[0] == pytest.approx(range_m)
    assert hit[0] == (0 if np.isfinite(range_m) else NOTHING)


def test_level_ground_is_met_at_the_height_over_the_sine() -> None:
    down = np.deg2rad(np.array([2.0, 5.0, 25.0]))
    directions = np.stack([np.cos(down), np.zeros(3), -np.sin(down)], axis=1)
    found, hit = ranges(FLAT, [], (np.tile([0.0, 0.0, 1.1], (3, 1)), directions))
    np.testing.assert_allclose(found, 1.1 / np.sin(down), rtol=1e-5)
    assert (hit == GROUND).all()


def test_shaped_ground_is_met_where_a_ray_sampled_every_centimetre_first_dips_into_it() -> None:
    ground, rng = SHAPED._replace(waves=WAVES), np.random.default_rng(3)
    places = rng.uniform(-22, 22, (400, 2))
    origins = np.column_stack([places, heights_m(ground, places) + 1.1])
    turned, down = rng.uniform(0, 2 * np.pi, 400), np.deg2rad(rng.uniform(-5, 25, 400))
    directions = np.stack([np.cos(down) * np.cos(turned), np.cos(down) * np.sin(turned), -np.sin(down)], axis=1)
    steps = np.arange(0.5, 30.0, 0.01)
    points = origins[:, None] + steps[:, None] * directions[:, None]
    dips = points[..., 2] < heights_m(ground, points[..., :2])
    expected = np.where(dips.any(axis=1), steps[dips.argmax(axis=1)], np.inf)
    found, _ = ranges(ground, [], (origins, directions))
    seen = np.isfinite(expected)
    assert seen.sum() > 200
    assert (np.abs(found[seen] - expected[seen]) < 0.02).mean() > 0.98
    assert (found[~seen] > 29.9).all()


def test_grass_lets_rays_through_as_often_as_its_free_path_says() -> None:
    grass = Solid("grass", GRASS, (5, 0, 0), (0.5, 0.5, 0.5), free_path_m=0.6)
    luck = np.random.default_rng(1).random(20_000)
    rays = (np.tile([0.0, 0.0, 0.3], (20_000, 1)), np.tile([1.0, 0.0, 0.0], (20_000, 1)))
    ceiling = Ceiling(FLAT, np.full(2, -60.0), np.full(2, 60.0))
    found, _ = cast(rays, FLAT, ceiling, as_rows([grass]), luck)
    assert np.isinf(found).mean() == pytest.approx(np.exp(-1.0 / 0.6), abs=0.012)
