"""Noise: a function of place, beside slow ways of working it out."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulator.appearance import noise
from simulator.appearance.ground_cover import LAYERS, GroundCover
from simulator.scenery.terrain import bilinear

SHARP_M = 1e-3


def places(count: int, axes: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-300, 300, (count, axes)).astype(np.float32)


def value_at(cell: tuple[int, ...], layer: int) -> float:
    """The table's value at a corner of the lattice, the way the module's head says: a shuffle per axis."""
    start = int(noise._SHUFFLED[layer % noise.SIZE])
    if len(cell) == 3:
        start = int(noise._SHUFFLED[(start + cell[2]) % noise.SIZE])
    column = int(noise._SHUFFLED[(start + cell[0]) % noise.SIZE])
    return float(noise._VALUES[noise._SHUFFLED[column + cell[1] % noise.SIZE]])


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


@pytest.mark.parametrize(("axes", "fractal"), [(2, noise.plane_fractal), (3, noise.space_fractal)])
def test_a_fractal_is_what_the_slow_way_gives(axes: int, fractal) -> None:
    points = places(40, axes)
    footprint = np.linspace(0.01, 1.2, 40, dtype=np.float32)
    slow = [slow_fractal(point, 1.6, 4, float(size), 9) for point, size in zip(points, footprint, strict=True)]
    np.testing.assert_allclose(fractal(points, 1.6, 4, footprint, 9), slow, atol=2e-3)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 200), st.sampled_from([0.05, 0.7, 6.0]), st.integers(1, 5))
def test_noise_stays_within_one_and_does_not_depend_on_what_else_is_asked(
    seed: int, wavelength_m: float, octaves: int
) -> None:
    points, footprint = places(50, 3, seed), np.full(50, SHARP_M, np.float32)
    values = noise.space_fractal(points, wavelength_m, octaves, footprint, seed)
    assert np.all(np.abs(values) < 1)
    alone = noise.space_fractal(points[7:8], wavelength_m, octaves, footprint[:1], seed)
    np.testing.assert_array_equal(alone, values[7:8])


def test_what_is_finer_than_a_pixel_is_not_drawn() -> None:
    points = places(100, 2)
    coarse = np.full(100, 0.5, np.float32)
    assert np.all(noise.plane_fractal(points, 0.5, 3, coarse, 1) == 0)
    one = noise.plane_fractal(points, 1.0, 1, coarse, 1)
    np.testing.assert_array_equal(noise.plane_fractal(points, 1.0, 4, coarse, 1), one)


def test_layers_have_nothing_in_common() -> None:
    points, footprint = places(5000, 2), np.full(5000, SHARP_M, np.float32)
    one, other = (noise.plane_fractal(points, 1.0, 3, footprint, layer) for layer in (11, 31))
    assert abs(np.corrcoef(one, other)[0, 1]) < 0.1
    assert abs(one.mean()) < 0.02


def test_a_stone_is_the_nearest_of_all_around() -> None:
    points = places(60, 2) / 50
    inside, tone = noise.stones(points, 0.2, 5)
    for index, (x, y) in enumerate(points.astype(float) / 0.2):
        nearest = (9.0, 0.0)
        for i in range(math.floor(x) - 3, math.floor(x) + 4):
            for j in range(math.floor(y) - 3, math.floor(y) + 4):
                cell = int(noise._SHUFFLED[noise._SHUFFLED[(i + 5) % noise.SIZE] + j % noise.SIZE])
                middle = (i + 0.5 + 0.4 * noise._VALUES[cell], j + 0.5 + 0.4 * noise._VALUES[cell + 1])
                away = (middle[0] - x) ** 2 + (middle[1] - y) ** 2
                nearest = min(nearest, (float(away), float(noise._VALUES[cell + 2])))
        assert inside[index] == pytest.approx(max(1 - nearest[0] / 0.3, 0), abs=1e-3)
        assert tone[index] == pytest.approx(nearest[1], abs=1e-6)


def test_the_cover_is_bilinear_between_lattice_points_and_goes_on_beyond_its_edge() -> None:
    layers = np.random.default_rng(1).random((9, 7, LAYERS)).astype(np.float32)
    cover = GroundCover(layers, (2.0, -1.0), 0.5)
    xy = np.random.default_rng(2).uniform((0, -4), (8, 6), (300, 2)).astype(np.float32)
    column_row = (xy - (2.0, -1.0)) / 0.5
    for layer in range(LAYERS):
        np.testing.assert_allclose(cover.at(xy)[:, layer], bilinear(layers[..., layer], column_row), atol=1e-5)
