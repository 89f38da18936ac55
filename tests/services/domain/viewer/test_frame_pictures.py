"""Grids of a frame as they are read, their pictures against a loop, and colours exchanged without decoding them."""

import io

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from services.domain.viewer.frame_grids import read_grids
from services.domain.viewer.frame_picture import (
    GROUND_INDEX,
    LIGHTS,
    UNSEEN_INDEX,
    comparison_picture,
    lit,
    of_class,
    picture_bytes,
    plan,
    png_of,
    recoloured,
    rgb_on_paper,
    with_words,
)
from stone.labels.class_colours import CLASS_RGB, INK, PALETTES, PAPER, UNSEEN, ColourName
from stone_base.label_grid import PAPER as GRID
from stone_base.label_grid import RELEASE, LabelGrid
from stone_files.npz import npz_bytes
from testing.colour_vision import least_of_pairs
from testing.refusals import refused_as

RNG = np.random.default_rng(3)
EVERY_INDEX = np.concatenate([np.arange(56), RNG.integers(0, 56, 56 * 9)]).astype(np.uint8).reshape(10, 56)
PICTURES = {"every": EVERY_INDEX, "one colour": np.full((4, 4), of_class(1), np.uint8)}


def opened(png: bytes) -> Image.Image:
    image = Image.open(io.BytesIO(png))
    image.load()  # which checks the chunks' CRC
    return image


@pytest.mark.parametrize("level", [3, 9])
@pytest.mark.parametrize("picture", PICTURES.values(), ids=PICTURES)
def test_colours_are_exchanged_and_back(picture: NDArray[np.uint8], level: int) -> None:
    png = png_of(picture, level)
    paper = recoloured(png, "paper")
    assert paper != png
    assert recoloured(paper, "default") == png
    assert recoloured(png, "default") == png
    np.testing.assert_array_equal(np.asarray(opened(paper)), picture)


@pytest.mark.parametrize("colours", PALETTES)
def test_classes_have_their_colours_and_what_is_no_class_keeps_its_own(colours: ColourName) -> None:
    shown = np.asarray(opened(recoloured(png_of(EVERY_INDEX), colours)).convert("RGBA"))
    default = np.asarray(opened(png_of(EVERY_INDEX)).convert("RGBA"))
    for kind, rgb in PALETTES[colours].items():
        assert tuple(shown[of_class(kind) == EVERY_INDEX][0]) == (*rgb, 255)
    is_class = (EVERY_INDEX >= 1) & (EVERY_INDEX < UNSEEN_INDEX)
    np.testing.assert_array_equal(shown[~is_class], default[~is_class])


def foreign_files() -> dict[str, bytes]:
    files = {}
    for name, mode, format in (("jpeg", "RGB", "JPEG"), ("rgb", "RGB", "PNG"), ("indexed", "P", "PNG")):
        content = io.BytesIO()
        Image.new(mode, (300, 300), 7).save(content, format)
        files[name] = content.getvalue()
    whole = png_of(EVERY_INDEX)
    return files | {"cut": whole[:500], "empty": b"", "mark": b"\x89PNG\r\n" + b"seed", "head": whole[:41]}


@pytest.mark.parametrize(("name", "content"), foreign_files().items(), ids=foreign_files().keys())
def test_what_is_no_picture_of_ours_stays_as_it_is(name: str, content: bytes) -> None:
    """Catches alone a picture of an earlier label set, stored in the paper's colours, that is served damaged."""
    assert recoloured(content, "paper") == content, name


def test_relief_never_makes_one_class_look_like_another() -> None:
    """Catches alone shading that undoes the palette: with the earlier light two classes came to CIEDE2000 3.5."""
    assert len(LIGHTS) == 9
    assert (min(LIGHTS), max(LIGHTS)) == pytest.approx((0.82, 1.18))
    assert least_of_pairs(list(CLASS_RGB.values()), LIGHTS) >= 25


def test_the_steeper_the_relief_the_brighter_up_to_four_steps() -> None:
    kinds, steps = np.full(11, 1, np.uint8), np.arange(-5.0, 6.0)
    brightness = rgb_on_paper(lit(kinds, steps)).sum(axis=1).tolist()
    assert brightness == sorted(brightness)
    assert len(set(brightness)) == 9
    assert lit(np.array([0, 1, 2, 3], np.uint8), np.array([3, np.nan, 0, 0])).tolist() == [
        GROUND_INDEX,
        *(of_class(kind) for kind in (1, 2, 3)),
    ]


def test_on_paper_the_ground_is_paper_and_the_unseen_its_grey() -> None:
    shown = rgb_on_paper(np.array([GROUND_INDEX, UNSEEN_INDEX, of_class(2)], np.uint8))
    assert [tuple(colour) for colour in shown.tolist()] == [PAPER, UNSEEN, CLASS_RGB[2]]


def test_words_are_laid_over_the_picture_and_read_on_light_and_dark() -> None:
    mask = Image.new("L", (3, 1))
    mask.putdata([0, 128, 255])
    written = with_words(np.full((1, 3), of_class(1), np.uint8), mask)
    colours = np.asarray(opened(png_of(written)).convert("RGBA"))[0]
    assert tuple(colours[0]) == (*CLASS_RGB[1], 255)
    assert [int(alpha) for alpha in colours[1:, 3]] == [136, 255]


def test_every_column_shows_its_highest_label_and_forward_is_up() -> None:
    rng = np.random.default_rng(0)
    semantics = np.zeros(GRID.shape, np.uint8)
    semantics[40:90, 60:140] = (rng.integers(1, 4, (50, 80, 32)) * (rng.random((50, 80, 32)) < 0.05)).astype(np.uint8)
    mask = np.zeros(GRID.shape, np.uint8)
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
    semantics = np.zeros(GRID.shape, np.uint8)
    for i in range(100, 110):
        semantics[i, :, i - 95] = 2
        semantics[i + 20, :, 20 - (i - 95)] = 2
    shown = plan(semantics)
    assert shown[255 - 104, 100, 0] != shown[255 - 124, 100, 0]


def test_the_picture_has_two_pixels_a_voxel_and_the_robot_in_the_middle() -> None:
    semantics = np.zeros(GRID.shape, np.uint8)
    semantics[200, 30, 5] = 3  # 14.4 m ahead, 19.5 m to the right
    png = Image.open(io.BytesIO(picture_bytes(semantics, np.ones(GRID.shape, np.uint8))))
    pixels = np.asarray(png.convert("RGBA"))
    assert pixels.shape == (512, 512, 4)
    assert tuple(pixels[256, 256]) == (*INK, 255)
    assert {tuple(pixel) for pixel in pixels[110:112, 450:452].reshape(-1, 4).tolist()} == {(*CLASS_RGB[3], 255)}
    assert pixels[108, 450, 3] == 0  # free, and seen: the page shows through


OTHER_GRIDS = {
    "release": (RELEASE, 3),
    "aside": (LabelGrid("aside", (-6.4, -12.8, -1.0), 0.4, (64, 40, 8)), 8),
    "largest": (LabelGrid("largest", (-51.2, -51.2, -1.0), 0.2, (512, 512, 16)), 1),
}


@pytest.mark.parametrize(("grid", "side_px"), OTHER_GRIDS.values(), ids=OTHER_GRIDS)
def test_a_picture_of_another_grid_has_about_the_same_size_and_the_robot_at_its_ego_origin(
    grid: LabelGrid, side_px: int
) -> None:
    """Catches alone columns read as words of 32 voxels, and a robot in the middle of a grid that lies aside."""
    x, y, z = grid.shape
    semantics = np.zeros(grid.shape, np.uint8)
    semantics[x - 2, 5, [0, z - 1]] = 1, 3  # in front, to the right
    observed = np.ones(grid.shape, np.uint8)
    observed[0, 0] = 0
    pixels = np.asarray(opened(picture_bytes(semantics, observed, grid)).convert("RGBA"))
    assert pixels.shape == (x * side_px, y * side_px, 4)
    assert 384 <= max(x, y) * side_px <= 640
    column = pixels[side_px : 2 * side_px, (y - 6) * side_px : (y - 5) * side_px]
    assert {tuple(pixel) for pixel in column.reshape(-1, 4).tolist()} == {(*CLASS_RGB[3], 255)}
    assert (pixels[-side_px:, -side_px:, 3] > 0).all(), "behind on the right nothing was seen"
    assert pixels[0, 0, 3] == 0
    down, right = (round((high / grid.voxel_m) * side_px) for high in grid.max_m[:2])
    assert tuple(pixels[down, right]) == (*INK, 255)
    beside = opened(comparison_picture((semantics, observed), (semantics * 0, None)))
    assert (beside.width - 3 * y * side_px, beside.height - x * side_px) == (2 * 16, 28)


def grids(seed: int = 0) -> dict[str, NDArray[np.uint8]]:
    rng = np.random.default_rng(seed)
    return {
        key: (rng.integers(0, 4, GRID.shape) * (rng.random(GRID.shape) < 0.02)).astype(np.uint8)
        for key in ("semantics", "mask_lidar", "mask_camera")
    }


def test_the_grids_are_those_that_numpy_reads() -> None:
    payload = npz_bytes(grids())
    with np.load(io.BytesIO(payload)) as archive:
        for key, found in zip(
            ("mask_lidar", "semantics"), read_grids(payload, ("mask_lidar", "semantics")), strict=True
        ):
            np.testing.assert_array_equal(found, archive[key])


def test_what_is_damaged_or_of_another_form_is_named() -> None:
    payload = npz_bytes(grids())
    flipped = bytearray(payload)
    flipped[60:90] = bytes(30)
    small = npz_bytes({"semantics": np.zeros((2, 2, 2), np.uint8)})
    wide = npz_bytes({"semantics": np.zeros(GRID.shape, np.int16)})
    for content, reason in ((bytes(flipped), "semantics"), (small, "2, 2, 2"), (wide, "<i2"), (b"no zip", "zip")):
        with refused_as("grid_unreadable", match=reason):
            read_grids(content, ("semantics",))
    with refused_as("grid_unreadable", match="absent"):
        read_grids(payload, ("absent",))
