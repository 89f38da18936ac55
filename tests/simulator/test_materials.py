"""What covers the ground, and how materials look."""

from dataclasses import replace

import numpy as np
import pytest

from simulator.appearance import materials
from simulator.appearance.ground_cover import GRAVEL, ROCK, SOIL, TALL, build_ground_cover, smooth_normals
from simulator.appearance.materials import COURSE_M, Spots
from simulator.appearance.shading import MATERIALS
from simulator.options import SimulateOptions
from simulator.scenery.drivability import drivability
from simulator.scenery.world import SimulatedWorld, build_world, generator

GROUND = {
    "grass": lambda spots: materials.grass(spots, np.zeros(len(spots.up_m), np.float32)),
    "soil": materials.soil,
    "gravel": materials.gravel,
}
ALL = {**GROUND, **{surface.name.lower(): colour for surface, colour in MATERIALS.items()}}


@pytest.fixture(scope="module")
def world() -> SimulatedWorld:
    return build_world(SimulateOptions(seconds=6.0, seed=2, world_width_m=60.0))


def spots_on_a_square(count: int = 4000, footprint_m: float = 0.004) -> Spots:
    draw = np.random.default_rng(3)
    points = draw.uniform(0, 12, (count, 3)).astype(np.float32)
    normals = np.tile(np.float32([1, 0, 0]), (count, 1))
    return Spots(points, normals, points[:, 2] / 8, np.full(count, footprint_m, np.float32))


def test_shares_of_the_ground_never_exceed_the_whole(world: SimulatedWorld) -> None:
    layers = build_ground_cover(world.terrain, generator(2, "cover")).layers
    shares = layers[..., [SOIL, GRAVEL, ROCK, TALL]]
    assert shares.min() >= 0
    assert shares.sum(axis=-1).max() <= 1 + 1e-5


def test_looks_go_with_drivability(world: SimulatedWorld) -> None:
    """The track is bare, what is too steep is rock, earth or gravel, and most of the rest is grass."""
    terrain = world.terrain
    layers = build_ground_cover(terrain, generator(2, "cover")).layers
    field, bare = drivability(terrain.height_m, terrain.resolution_m), layers[..., [SOIL, GRAVEL, ROCK]].sum(axis=-1)
    is_beside = terrain.path_distance_m > 3.0
    assert layers[terrain.path_distance_m < 0.5, SOIL].mean() > 0.5
    assert bare[is_beside & field.is_drivable & (field.slope_rad < 0.3)].mean() < 0.2
    assert bare[is_beside & (field.slope_rad > np.deg2rad(32))].mean() > 0.8
    assert layers[~terrain.lowland & (field.slope_rad > np.deg2rad(38)), ROCK].mean() > 0.8


def test_the_smooth_normal_is_square_to_the_slope(world: SimulatedWorld) -> None:
    cover = build_ground_cover(world.terrain, generator(2, "cover"))
    xy = np.random.default_rng(0).uniform(10, 30, (50, 2)).astype(np.float32)
    normals = smooth_normals(cover.at(xy))
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-5)
    assert np.all(normals[:, 2] > 0.3)


@pytest.mark.parametrize("name", ALL)
def test_a_material_reflects_some_of_the_light_and_the_same_whatever_else_is_seen(name: str) -> None:
    spots = spots_on_a_square()
    colours = ALL[name](spots)
    assert colours.shape == (4000, 3)
    assert 0 < colours.min() <= colours.max() < 1
    np.testing.assert_array_equal(ALL[name](spots.of(np.arange(5, 9))), colours[5:9])


@pytest.mark.parametrize("name", ALL)
def test_from_far_away_a_material_is_its_own_mean(name: str) -> None:
    near = ALL[name](spots_on_a_square())
    far = ALL[name](spots_on_a_square(footprint_m=3.0))
    np.testing.assert_allclose(far.mean(axis=0), near.mean(axis=0), rtol=0.25)
    assert far.std(axis=0).max() <= near.std(axis=0).max() + 1e-6


def test_bark_changes_more_around_the_trunk_than_along_it() -> None:
    spots = spots_on_a_square()
    along = replace(spots, points=spots.points + np.float32([0, 0, 0.03]))
    around = replace(spots, points=spots.points + np.float32([0.03, 0, 0]))
    here = materials.bark(spots)
    assert np.abs(materials.bark(around) - here).mean() > 1.5 * np.abs(materials.bark(along) - here).mean()


def test_a_wall_has_a_light_joint_at_every_course() -> None:
    spots = spots_on_a_square()
    brightness = materials.masonry(spots).mean(axis=1)
    apart_m = np.abs((spots.points[:, 2] + COURSE_M / 2) % COURSE_M - COURSE_M / 2)
    assert brightness[apart_m < 0.008].mean() > 1.3 * brightness[apart_m > 0.04].mean()
