"""The picture of a frame against a loop over its columns."""

import io

import numpy as np
from PIL import Image

from services.domain.viewer.frame_picture import picture_bytes, plan
from stone.labels.class_colours import CLASS_RGB, INK, PAPER, UNSEEN
from stone.labels.grid import GRID_SHAPE


def test_every_column_shows_its_highest_label_and_forward_is_up() -> None:
    rng = np.random.default_rng(0)
    semantics = np.zeros(GRID_SHAPE, np.uint8)
    semantics[40:90, 60:140] = (rng.integers(1, 4, (50, 80, 32)) * (rng.random((50, 80, 32)) < 0.05)).astype(np.uint8)
    mask = np.zeros(GRID_SHAPE, np.uint8)
    mask[:128, :, 3] = 1
    shown = plan(semantics, mask)
    hues = np.array([CLASS_RGB[kind] for kind in (1, 2, 3)], float)
    for i, j in [*rng.integers(0, 256, (300, 2)).tolist(), *rng.integers((40, 60), (90, 140), (300, 2)).tolist()]:
        kinds = [int(kind) for kind in semantics[i, j] if kind]
        colour = shown[255 - i, 255 - j]
        if not kinds:
            assert tuple(colour) == (PAPER if mask[i, j].any() else UNSEEN)
        else:  # the class's colour in more or less light
            lights = np.minimum(np.outer(1 + 0.045 * np.arange(-4, 5), hues[kinds[-1] - 1]), 255)
            assert np.abs(lights - colour).max(axis=1).min() <= 0.5


def test_relief_that_rises_is_lit_otherwise_than_relief_that_falls() -> None:
    semantics = np.zeros(GRID_SHAPE, np.uint8)
    for i in range(100, 110):
        semantics[i, :, i - 95] = 2
        semantics[i + 20, :, 20 - (i - 95)] = 2
    shown = plan(semantics)
    assert shown[255 - 104, 100, 0] != shown[255 - 124, 100, 0]


def test_the_picture_has_two_pixels_a_voxel_and_the_robot_in_the_middle() -> None:
    semantics = np.zeros(GRID_SHAPE, np.uint8)
    semantics[200, 30, 5] = 3  # 14.4 m ahead, 19.5 m to the right
    png = Image.open(io.BytesIO(picture_bytes(semantics, np.ones(GRID_SHAPE, np.uint8))))
    pixels = np.asarray(png.convert("RGBA"))
    assert pixels.shape == (512, 512, 4)
    assert tuple(pixels[256, 256]) == (*INK, 255)
    assert {tuple(pixel) for pixel in pixels[110:112, 450:452].reshape(-1, 4).tolist()} == {(*CLASS_RGB[3], 255)}
    assert pixels[108, 450, 3] == 0  # free, and seen: the page shows through
