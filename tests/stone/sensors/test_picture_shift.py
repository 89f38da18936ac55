"""Pictures that were moved by a known shift and turn say so."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates

from stone.sensors.picture_shift import brightness_of, picture_shift

HEIGHT, WIDTH = 75, 120


def scenery(seed: int) -> NDArray[np.float64]:
    drawn = np.random.default_rng(seed).normal(size=(HEIGHT + 80, WIDTH + 80))
    return np.asarray(128 + 300 * gaussian_filter(drawn, 2.5))


def seen(scene: NDArray[np.float64], right: float, down: float, roll: float) -> NDArray[np.float32]:
    """The middle of the scene, so that the point x of the picture before lies at x + shift + roll × x."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH].astype(np.float64)
    y, x = rows - (HEIGHT - 1) / 2 - down, columns - (WIDTH - 1) / 2 - right
    places = np.stack([y - roll * x + (HEIGHT + 79) / 2, x + roll * y + (WIDTH + 79) / 2])
    return np.asarray(map_coordinates(scene, places, order=3), np.float32)


@given(st.floats(-12, 12), st.floats(-8, 8), st.floats(-0.03, 0.03), st.integers(0, 99))
@settings(max_examples=40, deadline=None)
def test_a_shift_and_a_turn_are_found(right: float, down: float, roll: float, seed: int) -> None:
    scene = scenery(seed)
    found = picture_shift(seen(scene, 0, 0, 0), seen(scene, right, down, roll))
    assert found is not None
    assert np.abs(found[:2] - (right, down)).max() < 0.15
    assert abs(found[2] - roll) < 0.005


def test_what_moves_by_itself_counts_little() -> None:
    scene = scenery(1)
    first, second = seen(scene, 0, 0, 0), seen(scene, 3.0, 1.0, 0)
    walker = seen(scenery(2), 0, 0, 0)[20:40, 10:30]
    first[20:40, 10:30], second[20:40, 30:50] = walker, walker
    found = picture_shift(first, second)
    assert found is not None
    assert np.abs(found[:2] - (3.0, 1.0)).max() < 0.4


@pytest.mark.parametrize("side", [(8, 120), (75, 8)])
def test_a_picture_that_is_too_small_tells_nothing(side: tuple[int, int]) -> None:
    picture = np.random.default_rng(1).normal(size=side).astype(np.float32) * 50
    assert picture_shift(picture, picture) is None


def test_a_picture_that_shows_nothing_tells_nothing() -> None:
    flat = np.full((HEIGHT, WIDTH), 40.0, np.float32)
    assert picture_shift(flat, flat) is None
    assert picture_shift(flat, seen(scenery(1), 0, 0, 0)) is None


def test_pictures_of_two_sizes_are_not_compared() -> None:
    picture = seen(scenery(1), 0, 0, 0)
    assert picture_shift(picture, picture[:-1]) is None


def test_brightness_is_the_mean_of_the_colours() -> None:
    pixels = np.zeros((20, 30, 3), np.uint8)
    pixels[..., 1] = 90
    assert np.allclose(brightness_of(pixels), 30.0)
