"""Four lens models held to a slow one and to closed forms; pictures that were moved say so."""

from math import atan2, hypot

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates

from stone.errors import ShapeError
from stone.sensors.calibration import CameraIntrinsics
from stone.sensors.picture_shift import brightness_of, picture_shift
from stone.sensors.projection import field_limit, is_folded, project, rays_through

LENSES = {
    "pinhole": CameraIntrinsics("pinhole", 640, 480, 500, 505, 322.5, 241.0),
    "plumb_bob": CameraIntrinsics(
        "plumb_bob", 752, 480, 458.6, 457.3, 367.2, 248.4, (-0.283, 0.074, 2e-4, -1.8e-5, 0.0)
    ),
    "rational_polynomial": CameraIntrinsics(
        "rational_polynomial", 1280, 720, 610, 611, 640, 365, (0.4, -0.1, 1e-3, -4e-4, 0.02, 0.7, -0.05, 0.01)
    ),
    "equidistant": CameraIntrinsics("equidistant", 512, 512, 191, 191, 255, 257, (0.0035, 0.0007, -0.002, 0.0002)),
}
MODELS = pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES)
# Mostly before the camera, so that many are in the image.
points = st.tuples(st.floats(-0.8, 0.8), st.floats(-0.8, 0.8), st.floats(0.2, 30)).map(
    lambda p: (p[0] * p[2], p[1] * p[2], p[2])
)


def slow_pixel(point: tuple[float, float, float], lens: CameraIntrinsics) -> tuple[float, float]:
    """The models as they are written in their papers, for one point before the camera."""
    x, y, z = point
    d = lens.distortion
    if lens.model == "equidistant":
        side = hypot(x, y)
        t = atan2(side, z)
        bent = t + d[0] * t**3 + d[1] * t**5 + d[2] * t**7 + d[3] * t**9
        a, b = (x / side * bent, y / side * bent) if side else (0.0, 0.0)
        return lens.fx_px * a + lens.cx_px, lens.fy_px * b + lens.cy_px
    a, b = x / z, y / z
    r2 = a * a + b * b
    k1, k2, p1, p2, k3, k4, k5, k6 = (*d, *[0.0] * (8 - len(d)))
    radial = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1 + k4 * r2 + k5 * r2**2 + k6 * r2**3)
    u = a * radial + 2 * p1 * a * b + p2 * (r2 + 2 * a * a)
    v = b * radial + p1 * (r2 + 2 * b * b) + 2 * p2 * a * b
    return lens.fx_px * u + lens.cx_px, lens.fy_px * v + lens.cy_px


@MODELS
@settings(max_examples=60, deadline=None)
@given(point=points)
def test_every_point_in_the_image_is_where_the_slow_model_puts_it(lens: CameraIntrinsics, point) -> None:
    pixels, is_in_image = project(np.array([point]), lens)
    assume(is_in_image[0])
    np.testing.assert_allclose(pixels[0], slow_pixel(point, lens), atol=1e-9 * lens.width_px)


@MODELS
def test_the_axis_is_seen_at_the_principal_point(lens: CameraIntrinsics) -> None:
    pixels, is_in_image = project(np.array([[0.0, 0, 5]]), lens)
    assert is_in_image.all()
    np.testing.assert_allclose(pixels, [[lens.cx_px, lens.cy_px]])


@MODELS
def test_what_is_behind_or_nowhere_is_not_seen(lens: CameraIntrinsics) -> None:
    nowhere = np.array([[0.0, 0, -5], [0, 0, 0], [np.nan, 0, 1], [0, np.inf, 1], [0, 0, -np.inf]])
    assert not project(nowhere, lens)[1].any()
    assert project(np.zeros((0, 3)), lens)[0].shape == (0, 2)


@MODELS
def test_the_ray_through_a_pixel_is_seen_in_that_pixel(lens: CameraIntrinsics) -> None:
    """Catches alone an inverse that is off, or that goes on beyond where the lens turns."""
    random = np.random.default_rng(7)
    pixels = random.uniform(-0.5, (lens.width_px - 0.5, lens.height_px - 0.5), (500, 2))
    rays = rays_through(pixels, lens)
    is_known = np.isfinite(rays).all(axis=1)
    assert is_known.mean() > 0.75
    np.testing.assert_allclose(np.linalg.norm(rays[is_known], axis=1), 1)
    seen, is_in_image = project(rays[is_known] * random.uniform(0.5, 50, (int(is_known.sum()), 1)), lens)
    assert is_in_image.all()
    np.testing.assert_allclose(seen, pixels[is_known], atol=1e-3)


@settings(max_examples=20, deadline=None)
@given(
    coefficients=st.tuples(st.floats(-0.3, 0.3), st.floats(-0.05, 0.05), st.floats(-2e-3, 2e-3), st.floats(-2e-3, 2e-3))
)
@example((-0.271484375, 0.026889659683400832, 0.0, 0.0))  # it turns within the outer half of the corner's pixel
def test_rays_of_drawn_lenses_are_exact_and_hold_all_that_is_seen(coefficients: tuple[float, ...]) -> None:
    lens = CameraIntrinsics("plumb_bob", 640, 480, 500, 505, 322.5, 241.0, (*coefficients, 0.0))
    assume(not is_folded(lens))
    pixels = np.stack(np.meshgrid(np.linspace(-0.5, 639.5, 17), np.linspace(-0.5, 479.5, 13)), axis=-1).reshape(-1, 2)
    rays = rays_through(pixels, lens)
    assert np.isfinite(rays).all()
    np.testing.assert_allclose(project(rays, lens)[0], pixels, atol=1e-3)


def test_beyond_the_turn_of_a_lens_there_is_no_ray() -> None:
    lens = CameraIntrinsics("plumb_bob", 640, 480, 200, 200, 320, 240, (-0.3, 0, 0, 0, 0))
    assert np.isfinite(rays_through(np.array([[320.0, 240.0]]), lens)).all()
    assert np.isnan(rays_through(np.array([[0.0, 0.0], [639.0, 479.0]]), lens)).all()


def test_pixels_and_points_of_another_shape_are_refused() -> None:
    for ask, shape in ((rays_through, (3, 3)), (project, (3,))):
        with pytest.raises(ShapeError):
            ask(np.zeros(shape), LENSES["pinhole"])


def test_the_image_reaches_half_a_pixel_around_its_pixels() -> None:
    lens = CameraIntrinsics("pinhole", 100, 50, 100, 100, 0, 0)
    edges = np.array([[-0.005, 0, 1], [-0.00501, 0, 1], [0.99499, 0.49499, 1], [0.9951, 0, 1], [0, 0.4951, 1]])
    assert project(edges, lens)[1].tolist() == [True, False, True, False, False]


def test_a_lens_that_turns_back_shows_nothing_twice() -> None:
    """With k1 = −0.5 the picture turns at r = √(2/3): a point at r = 1.3 would be put at 0.2, well inside."""
    lens = CameraIntrinsics("plumb_bob", 640, 480, 500, 500, 320, 240, (-0.5, 0, 0, 0, 0))
    assert field_limit(lens) == pytest.approx((2 / 3) ** 0.5, abs=5e-3)
    assert slow_pixel((1.3, 0, 1), lens)[0] < 640
    assert project(np.array([[1.3, 0, 1.0], [0.5, 0, 1.0]]), lens)[1].tolist() == [False, True]
    assert is_folded(lens)


@MODELS
def test_a_real_lens_is_one_to_one_up_to_its_corner(lens: CameraIntrinsics) -> None:
    assert not is_folded(lens)


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
@settings(max_examples=20, deadline=None)
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


def test_pictures_that_are_too_small_show_nothing_or_have_two_sizes_tell_nothing() -> None:
    noise = np.random.default_rng(1).normal(size=(HEIGHT, WIDTH)).astype(np.float32) * 50
    flat, picture = np.full((HEIGHT, WIDTH), 40.0, np.float32), seen(scenery(1), 0, 0, 0)
    low, narrow = noise[:8], noise[:, :8]
    for one, other in ((low, low), (narrow, narrow), (flat, flat), (flat, picture), (picture, picture[:-1])):
        assert picture_shift(one, other) is None


def test_brightness_is_the_mean_of_the_colours() -> None:
    pixels = np.zeros((20, 30, 3), np.uint8)
    pixels[..., 1] = 90
    assert np.allclose(brightness_of(pixels), 30.0)
