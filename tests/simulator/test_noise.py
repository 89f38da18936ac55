"""Noise: a function of place, beside slow ways of working it out."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulator.appearance import materials
from simulator.appearance.materials import LAYERS, GroundCover
from simulator.options import SimulateOptions
from simulator.pipeline import simulate
from simulator.scenery.terrain import bilinear
from simulator.sensors.lidar import RangeNoise, Ranges, Returns, detected_share, disturbed, mixed, rained
from tests.simulator.conftest import TINY, Recording

SHARP_M = 1e-3


def places(count: int, axes: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-300, 300, (count, axes)).astype(np.float32)


def value_at(cell: tuple[int, ...], layer: int) -> float:
    """The table's value at a corner of the lattice, the way the module's head says: a shuffle per axis."""
    start = int(materials._SHUFFLED[layer % materials.SIZE])
    if len(cell) == 3:
        start = int(materials._SHUFFLED[(start + cell[2]) % materials.SIZE])
    column = int(materials._SHUFFLED[(start + cell[0]) % materials.SIZE])
    return float(materials._VALUES[materials._SHUFFLED[column + cell[1] % materials.SIZE]])


def slow_fractal(place: np.ndarray, wavelength_m: float, octaves: int, footprint_m: float, layer: int) -> float:
    total = 0.0
    for octave in range(octaves):
        scaled = place.astype(float) * 2**octave / wavelength_m
        low = [math.floor(one) for one in scaled]
        ratio = [3 * r**2 - 2 * r**3 for r in (scaled - low)]
        for corner in np.ndindex(*(2,) * len(place)):
            weight = math.prod(r if bit else 1 - r for r, bit in zip(ratio, corner, strict=True))
            cell = tuple(one + bit for one, bit in zip(low, corner, strict=True))
            fade = min(max(wavelength_m / 2**octave / footprint_m - 1, 0), 1)
            total += fade * 0.5 ** (octave + 1) * weight * value_at(cell, layer + octave)
    return total


@pytest.mark.parametrize(("axes", "fractal"), [(2, materials.plane_fractal), (3, materials.space_fractal)])
def test_a_fractal_is_what_the_slow_way_gives(axes: int, fractal) -> None:
    points = places(40, axes)
    footprint = np.linspace(0.01, 1.2, 40, dtype=np.float32)
    slow = [slow_fractal(point, 1.6, 4, float(size), 9) for point, size in zip(points, footprint, strict=True)]
    np.testing.assert_allclose(fractal(points, 1.6, 4, footprint, 9), slow, atol=2e-3)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 200), st.sampled_from([0.05, 0.7, 6.0]), st.integers(1, 5))
def test_noise_stays_within_one_and_does_not_depend_on_what_else_is_asked(seed, wavelength_m, octaves):
    points, footprint = places(50, 3, seed), np.full(50, SHARP_M, np.float32)
    values = materials.space_fractal(points, wavelength_m, octaves, footprint, seed)
    assert np.all(np.abs(values) < 1)
    alone = materials.space_fractal(points[7:8], wavelength_m, octaves, footprint[:1], seed)
    np.testing.assert_array_equal(alone, values[7:8])


def test_what_is_finer_than_a_pixel_is_not_drawn_and_layers_have_nothing_in_common() -> None:
    points = places(100, 2)
    coarse = np.full(100, 0.5, np.float32)
    assert np.all(materials.plane_fractal(points, 0.5, 3, coarse, 1) == 0)
    one = materials.plane_fractal(points, 1.0, 1, coarse, 1)
    np.testing.assert_array_equal(materials.plane_fractal(points, 1.0, 4, coarse, 1), one)
    points, footprint = places(5000, 2), np.full(5000, SHARP_M, np.float32)
    one, other = (materials.plane_fractal(points, 1.0, 3, footprint, layer) for layer in (11, 31))
    assert abs(np.corrcoef(one, other)[0, 1]) < 0.1
    assert abs(one.mean()) < 0.02


def test_a_stone_is_the_nearest_of_all_around() -> None:
    points = places(60, 2) / 50
    inside, tone = materials.stones(points, 0.2, 5)
    for index, (x, y) in enumerate(points.astype(float) / 0.2):
        nearest = (9.0, 0.0)
        for i in range(math.floor(x) - 3, math.floor(x) + 4):
            for j in range(math.floor(y) - 3, math.floor(y) + 4):
                cell = int(materials._SHUFFLED[materials._SHUFFLED[(i + 5) % materials.SIZE] + j % materials.SIZE])
                middle = (i + 0.5 + 0.4 * materials._VALUES[cell], j + 0.5 + 0.4 * materials._VALUES[cell + 1])
                away = (middle[0] - x) ** 2 + (middle[1] - y) ** 2
                nearest = min(nearest, (float(away), float(materials._VALUES[cell + 2])))
        assert inside[index] == pytest.approx(max(1 - nearest[0] / 0.3, 0), abs=1e-3)
        assert tone[index] == pytest.approx(nearest[1], abs=1e-6)


def test_the_cover_is_bilinear_between_lattice_points_and_goes_on_beyond_its_edge() -> None:
    layers = np.random.default_rng(1).random((9, 7, LAYERS)).astype(np.float32)
    cover = GroundCover(layers, (2.0, -1.0), 0.5)
    xy = np.random.default_rng(2).uniform((0, -4), (8, 6), (300, 2)).astype(np.float32)
    column_row = (xy - (2.0, -1.0)) / 0.5
    for layer in range(LAYERS):
        np.testing.assert_allclose(cover.at(xy)[:, layer], bilinear(layers[..., layer], column_row), atol=1e-5)


NOISE = RangeNoise()
RAYS = 200_000
CHANNELS = 4


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(1)


def ranges(value_m: float, count: int = RAYS) -> Ranges:
    return np.full(count, value_m, np.float32)


def met(range_m: float, cosine: float, reflectivity: float = 0.3) -> Returns:
    return Returns(ranges(range_m), ranges(cosine), ranges(reflectivity))


def stepped(near_m: float, far_m: float, columns: int) -> Ranges:
    """Columns that see a near surface and a far one in turn."""
    return np.tile(np.repeat(np.array([near_m, far_m], np.float32), CHANNELS), columns // 2)


def test_the_share_of_dropouts_is_the_models(rng: np.random.Generator) -> None:
    share = detected_share(met(NOISE.half_range_m, 1.0, NOISE.half_reflectivity), NOISE)
    assert share[0] == pytest.approx(0.5, abs=1e-6)
    without_rain = replace(NOISE, drops_reach_m=0.0)
    for range_m in (5.0, 15.0, 30.0):
        ground = met(range_m, 1.0 / range_m)
        returned = np.isfinite(disturbed(ground, CHANNELS, without_rain, rng)).mean()
        assert returned == pytest.approx(detected_share(ground, NOISE)[0], abs=0.005)
    sky = met(np.inf, 0.0, 0.0)
    assert not np.isfinite(disturbed(sky, CHANNELS, replace(NOISE, drops_reach_m=0.0), rng)).any()


@given(st.floats(0.5, 80.0), st.floats(0.03, 0.9), st.floats(0.02, 1.0))
def test_dropouts_grow_with_incidence_and_range_and_shrink_with_reflectivity(range_m, cosine, reflectivity):
    here, steeper, nearer, brighter = (
        detected_share(Returns(*(ranges(value, 1) for value in values)), NOISE)[0]
        for values in (
            (range_m, cosine, reflectivity),
            (range_m, cosine * 1.1, reflectivity),
            (range_m * 0.9, cosine, reflectivity),
            (range_m, cosine, reflectivity * 1.1),
        )
    )
    assert 0 <= here <= min(steeper, nearer, brighter)


def test_mixed_pixels_lie_between_the_two_surfaces_and_are_as_many_as_the_beam_is_wide(rng):
    columns = 900
    seen = np.concatenate([mixed(stepped(8.0, 9.0, columns), CHANNELS, NOISE, rng) for _ in range(60)])
    between = (seen > 8.0) & (seen < 9.0)
    assert seen.min() >= 8.0
    assert seen.max() <= 9.0
    assert between.mean() == pytest.approx(NOISE.beam_rad * columns / (2 * np.pi), abs=0.005)
    assert seen[between].mean() == pytest.approx(8.5, abs=0.01)


@pytest.mark.parametrize(("near_m", "far_m"), [(8.0, 8.05), (8.0, 10.0), (8.0, np.inf)])
def test_what_no_pulse_joins_is_not_mixed(near_m: float, far_m: float, rng: np.random.Generator) -> None:
    exact = stepped(near_m, far_m, 900)
    np.testing.assert_array_equal(mixed(exact, CHANNELS, NOISE, rng), exact)


def test_rain_stops_rays_at_its_rate_evenly_along_the_way_and_never_behind_a_surface(rng: np.random.Generator) -> None:
    heavy = replace(NOISE, drops_per_m=0.01)
    for range_m in (5.0, 15.0, 50.0, np.inf):
        reach_m = min(range_m, heavy.drops_reach_m)
        seen = rained(ranges(range_m), heavy, rng)
        drops = seen[seen != range_m]
        assert len(drops) / RAYS == pytest.approx(-np.expm1(-heavy.drops_per_m * reach_m), rel=0.04)
        assert drops.max() <= reach_m
        assert np.histogram(drops, 4, (0, reach_m))[0] / len(drops) == pytest.approx(0.25, abs=0.03)


@pytest.mark.whole
def test_a_recording_has_it_only_where_it_is_asked_for(recording: Recording, tmp_path: Path) -> None:
    noisy = replace(TINY, range_noise=True)
    simulate(tmp_path / "noisy.mcap", noisy)
    simulate(tmp_path / "again.mcap", noisy)
    assert (tmp_path / "noisy.mcap").read_bytes() == (tmp_path / "again.mcap").read_bytes()
    assert (tmp_path / "noisy.mcap").read_bytes() != recording.path.read_bytes()
    assert SimulateOptions().range_noise is False
