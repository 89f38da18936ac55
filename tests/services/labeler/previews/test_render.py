"""The voxel renderer against rays that are cast at every box, one pixel after the other."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.labeler.previews.render import SHADE, SIDE_LIGHT, Boxes, Camera, Canvas, beads, draw, voxel_boxes
from services.labeler.previews.sheet import oblique, surroundings_of
from stone.labels.class_colours import CLASS_RGB, PAPER
from testing.colour_vision import least_of_pairs
from tests.services.labeler.previews.sources import source_of

WIDTH, HEIGHT, FOCAL = 56, 40, 45.0
NUDGES = [(0.0, 0.0), (2e-3, 0.0), (-2e-3, 0.0), (0.0, 2e-3), (0.0, -2e-3)]
BLANK = (7, 8, 9)


def drawn(boxes: Boxes, camera: Camera) -> np.ndarray[Any, Any]:
    image, nearness = np.full((HEIGHT, WIDTH, 3), BLANK, np.uint8), np.zeros((HEIGHT, WIDTH), np.float32)
    seen_by = (camera.matrix(), camera.eye_m, np.array([FOCAL, WIDTH / 2, HEIGHT / 2]))
    draw((boxes.bounds_m, boxes.sides, boxes.light, boxes.rgb), seen_by, image, nearness)
    return image


def cast(boxes: Boxes, camera: Camera, pixel: tuple[float, float]) -> tuple[int, ...]:
    """The colour where the ray through this place of the picture first meets a side that may show."""
    x, y = (pixel[0] - WIDTH / 2) / FOCAL, (pixel[1] - HEIGHT / 2) / FOCAL
    ray = camera.matrix()[:, :3].T @ np.array([x, y, 1.0])
    nearest, colour = np.inf, BLANK
    for bounds, sides, light, rgb in zip(boxes.bounds_m, boxes.sides, boxes.light, boxes.rgb, strict=True):
        low, high = bounds[:3].astype(float), bounds[3:].astype(float)
        for side in range(6):
            axis, plane = side >> 1, (high if side & 1 else low)[side >> 1]
            faces_eye = camera.eye_m[axis] > plane if side & 1 else camera.eye_m[axis] < plane
            if not (int(sides) >> side) & 1 or not faces_eye or ray[axis] == 0:
                continue
            t = (plane - camera.eye_m[axis]) / ray[axis]
            at = camera.eye_m + t * ray
            others = [other for other in range(3) if other != axis]
            if 0 < t < nearest and all(low[o] <= at[o] <= high[o] for o in others):
                nearest, colour = t, tuple(np.floor(rgb * np.float64(light[side]) + 0.5).astype(int).tolist())
    return colour


@settings(max_examples=12, deadline=None)
@given(
    seed=st.integers(0, 2**31),
    eye=st.tuples(st.floats(-3, 3), st.floats(-3, 3), st.floats(0.5, 3)).filter(lambda e: np.hypot(e[0], e[1]) > 1.8),
)
def test_every_pixel_shows_the_side_that_a_ray_through_it_meets_first(seed, eye):
    rng = np.random.default_rng(seed)
    block = (rng.integers(1, 4, (4, 5, 3)) * (rng.random((4, 5, 3)) < 0.3)).astype(np.uint8)
    boxes = voxel_boxes(block, np.array([-0.4, -0.5, -0.3]))
    camera = Camera(np.array(eye), np.zeros(3), 1.0)
    image = drawn(boxes, camera)
    for row, column in rng.integers(0, (HEIGHT, WIDTH), (60, 2)):
        met = {cast(boxes, camera, (column + 0.5 + dx, row + 0.5 + dy)) for dx, dy in NUDGES}
        if len(met) == 1:  # else an edge runs through the pixel's centre
            assert np.abs(image[row, column].astype(int) - met.pop()).max() <= 1


def test_a_voxel_alone_shows_all_sides_and_neighbours_hide_what_they_share():
    block = np.zeros((5, 5, 5), np.uint8)
    block[2, 2, 2] = 1
    alone = voxel_boxes(block, np.zeros(3))
    assert alone.sides.tolist() == [0b111111]
    np.testing.assert_allclose(alone.light[0], SIDE_LIGHT, rtol=1e-6)
    np.testing.assert_allclose(alone.bounds_m[0], [0.4, 0.4, 0.4, 0.6, 0.6, 0.6], rtol=1e-6)
    block[3, 2, 2] = 3
    pair = voxel_boxes(block, np.zeros(3))
    assert pair.sides.tolist() == [0b111101, 0b111110]
    assert pair.rgb.tolist() == [list(CLASS_RGB[1]), list(CLASS_RGB[3])]


def test_ground_beside_a_wall_is_darker_than_open_ground():
    block = np.zeros((7, 7, 4), np.uint8)
    block[:, :, 0] = 2
    block[5, :, 1:] = 3
    boxes = voxel_boxes(block, np.zeros(3))
    top = {
        tuple(np.round(b[:3] / 0.2).astype(int)): light[5] for b, light in zip(boxes.bounds_m, boxes.light, strict=True)
    }
    assert top[(2, 3, 0)] == pytest.approx(1.0)
    assert top[(4, 3, 0)] == pytest.approx(1.0 - SHADE * 3 / 8)


def test_no_side_is_so_dark_that_a_class_looks_like_another():
    lights = np.linspace(min(SIDE_LIGHT) * (1.0 - SHADE), max(SIDE_LIGHT), 9)
    assert least_of_pairs(list(CLASS_RGB.values()), lights) >= 22


def test_what_is_behind_the_camera_is_not_drawn():
    camera = Camera(np.zeros(3), np.array([1.0, 0.0, 0.0]), 1.0)
    behind = beads(np.array([[-2, -1, -1, -1, 1, 1], [-1, -1, -1, 1, 1, 1]], np.float32), (255, 0, 0))
    assert (drawn(behind, camera) == BLANK).all()


def test_a_closed_sheet_of_ground_has_no_cracks():
    block = np.full((40, 40, 1), 2, np.uint8)
    camera = Camera(np.array([4.0, -3.0, 3.0]), np.array([4.0, 4.0, 0.0]), 1.0)
    canvas = Canvas(camera, 200, 120)
    canvas.add(voxel_boxes(block, np.zeros(3)))
    picture = np.asarray(canvas.image())
    inside = picture[60:110, 70:130].reshape(-1, 3)
    assert {tuple(colour) for colour in inside.tolist()} == {CLASS_RGB[2]}


def test_the_oblique_picture_shows_classes_robot_and_track_and_is_the_same_twice():
    source = source_of()
    pictures = [oblique(source.grids(1), surroundings_of(source.sequence, 1)) for _ in range(2)]
    assert pictures[0].size == (800, 480)
    assert pictures[0].tobytes() == pictures[1].tobytes()
    colours = {colour for _, colour in pictures[0].getcolors(1 << 20)}
    assert {CLASS_RGB[1], CLASS_RGB[2], PAPER} <= colours
    nothing = oblique({"semantics": np.zeros((256, 256, 32), np.uint8)})
    assert (np.asarray(nothing)[:100] == PAPER).all()
