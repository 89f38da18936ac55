"""The top-down picture of a frame's label grid: forward is up, left is left.

**Conventions.** Each pixel shows the highest labelled voxel of its column, shaded by the relief. Grey marks unobserved
columns; columns that were observed to be free are transparent (white on paper). Pictures are PNG files with one fixed
palette (below). Grids (X, Y, Z) have any size; Z is 8, 16 or 32. A column is a square of `px_per_column` pixels.
"""

import io
import struct
import zlib
from functools import cache

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from stone.labels.class_colours import INK, PALETTES, PAPER, TRACK, UNSEEN, ColourName
from stone.scoring.agreement import BOTH_FREE, EASIER, HARDER, ONLY_A, ONLY_B, SAME, differences
from stone_base.label_grid import LabelGrid

# Label pictures for pages: PNG files with one fixed palette, in which the class colours can be exchanged. A picture is
# an array (H, W) uint8 of palette indices. The background is transparent, so a picture fits light and dark pages;
# unobserved is a translucent grey. Each class has nine brightnesses for relief, chosen so that any two classes stay
# CIEDE2000 ≥ 25 apart under the three dichromacies. The colours are in one chunk (PLTE) of fixed length, so
# `recoloured` exchanges it without decoding the picture. Source: PNG 1.2 (RFC 2083), §4.1.2 (PLTE), §4.2.9 (tRNS).


Indices = NDArray[np.uint8]

RELIEF, STEPS = 0.045, 4
LIGHTS = tuple(1.0 + RELIEF * step for step in range(-STEPS, STEPS + 1))
GROUND_INDEX, UNSEEN_INDEX, CASING_INDEX, TRACK_INDEX, ROBOT_INDEX = 0, 28, 29, 30, 31
DIFFERENCE_INDEX = 31
"""Palette index of a difference: its code plus this offset."""
WORDS_INDEX, OPAQUE_INDEX = 40, 55
DIFFERENCE_RGB = {
    SAME: (189, 189, 184),
    ONLY_A: (86, 180, 233),
    ONLY_B: (230, 159, 0),
    EASIER: (150, 20, 20),
    HARDER: (20, 60, 150),
}
GREY, GREY_ALPHA, SAME_ALPHA, WORDS_RGB = (128, 132, 138), 90, 128, (112, 118, 126)
PALETTE_AT, PALETTE_BYTES = 41, 768


def lit(kinds: NDArray[np.uint8], steps: NDArray[np.float64]) -> Indices:
    """Return the palette indices of classes 0–3, brighter if the relief rises against the light, else darker.

    `steps` has the shape of `kinds`; NaN is level ground.
    """
    light = np.clip(np.nan_to_num(steps), -STEPS, STEPS).astype(np.int16) + STEPS
    return np.where(kinds > 0, 1 + len(LIGHTS) * (kinds.astype(np.int16) - 1) + light, GROUND_INDEX).astype(np.uint8)


def of_class(kind: int) -> int:
    """Return the palette index of a class in even light."""
    return 1 + len(LIGHTS) * (kind - 1) + STEPS


def with_words(indices: Indices, mask: Image.Image) -> Indices:
    """Return the picture with the text of the mask (mode "L", the picture's size) drawn over it."""
    words = np.asarray(mask) // 16
    return np.where(words > 0, WORDS_INDEX + words, indices).astype(np.uint8)


def png_of(indices: Indices, compress_level: int = 3) -> bytes:
    """Return the picture as an indexed PNG in the default colours."""
    image, file = Image.fromarray(indices), io.BytesIO()
    image.putpalette(palette_bytes("default"))
    image.save(file, "PNG", transparency=ALPHAS, compress_level=compress_level)
    return file.getvalue()


def recoloured(png: bytes, colours: ColourName) -> bytes:
    """Return a picture of `png_of` with these class colours; other files are returned unchanged."""
    end = PALETTE_AT + PALETTE_BYTES
    if png[37:PALETTE_AT] != b"PLTE" or png[PALETTE_AT:end] not in {palette_bytes(name) for name in PALETTES}:
        return png
    palette = palette_bytes(colours)
    return png[:PALETTE_AT] + palette + struct.pack(">I", zlib.crc32(b"PLTE" + palette)) + png[end + 4 :]


def rgb_on_paper(indices: Indices) -> NDArray[np.uint8]:
    """Return the picture (H, W, 3) in the default colours on white paper, for sheets and films."""
    return _on_paper()[indices]


@cache
def palette_bytes(colours: ColourName) -> bytes:
    """Return the 256 colours, RGB."""
    return _rgb(colours).tobytes()


@cache
def _rgb(colours: ColourName) -> NDArray[np.uint8]:
    table = np.full((256, 3), PAPER, np.uint8)  # for readers without transparency support
    for kind, colour in PALETTES[colours].items():
        lights = np.outer(LIGHTS, colour)
        first = of_class(kind) - STEPS
        table[first : first + len(LIGHTS)] = np.clip(np.round(lights), 0, 255)
    table[[UNSEEN_INDEX, CASING_INDEX, TRACK_INDEX, ROBOT_INDEX]] = GREY, PAPER, TRACK, INK
    for code, colour in DIFFERENCE_RGB.items():
        table[DIFFERENCE_INDEX + code] = GREY if code == SAME else colour
    table[WORDS_INDEX : OPAQUE_INDEX + 1] = WORDS_RGB
    return table


def _alphas() -> bytes:
    alphas = bytearray([255] * 256)
    alphas[GROUND_INDEX], alphas[UNSEEN_INDEX], alphas[DIFFERENCE_INDEX + SAME] = 0, GREY_ALPHA, SAME_ALPHA
    alphas[WORDS_INDEX : OPAQUE_INDEX + 1] = bytes(17 * step for step in range(OPAQUE_INDEX + 1 - WORDS_INDEX))
    return bytes(alphas)


ALPHAS = _alphas()
"""The opacity of the 256 colours, the same in every palette."""


@cache
def _on_paper() -> NDArray[np.uint8]:
    opacity = np.frombuffer(ALPHAS, np.uint8)[:, None] / 255.0
    table = np.round(_rgb("default") * opacity + np.array(PAPER) * (1.0 - opacity)).astype(np.uint8)
    table[[UNSEEN_INDEX, DIFFERENCE_INDEX + SAME]] = UNSEEN, DIFFERENCE_RGB[SAME]
    return table


Grid = NDArray[np.uint8]

SIDE_PX = 512
ROBOT_PX = ((0, -9), (6, 7), (0, 3), (-6, 7))  # an arrowhead that points forward


def picture_bytes(semantics: Grid, observed: Grid, grid: LabelGrid | None = None) -> bytes:
    """Return a PNG of the grids (X, Y, Z), with the robot at the ego origin of `place`, by default in the middle."""
    image = Image.fromarray(enlarged(plan_indices(semantics, observed)))
    right, down = np.array(image.size) / 2 if grid is None else _robot_px(grid)
    outline = [(right + x, down + y) for x, y in ROBOT_PX]
    ImageDraw.Draw(image).polygon(outline, fill=ROBOT_INDEX, outline=CASING_INDEX)
    return png_of(np.asarray(image))


def _robot_px(grid: LabelGrid) -> tuple[float, float]:
    """Return the pixel of the ego origin in a picture of this grid, from left and top."""
    px_per_m = px_per_column(grid.shape) / grid.voxel_m
    ahead_m, left_m, _ = grid.max_m
    return left_m * px_per_m, ahead_m * px_per_m


def plan(semantics: Grid, observed: Grid | None = None) -> Grid:
    """Return (X, Y, 3) on white paper, one pixel per column; with `observed`, unobserved columns are grey."""
    return rgb_on_paper(plan_indices(semantics, observed))


def plan_indices(semantics: Grid, observed: Grid | None = None) -> Indices:
    """Return the same (X, Y) as palette indices."""
    highest = _highest(semantics)
    kind = np.take_along_axis(semantics, highest[..., None], axis=2)[..., 0]
    shown = lit(kind, _rise(np.where(kind > 0, highest, np.nan)))
    if observed is not None:
        shown[(kind == 0) & ~_any_above(observed)] = UNSEEN_INDEX
    return np.ascontiguousarray(shown[::-1, ::-1])


def px_per_column(shape: tuple[int, ...]) -> int:
    """Return the width in pixels of a column of a grid (X, Y, …), so that the longer side has about `SIDE_PX`."""
    return max(1, round(SIDE_PX / max(shape[:2])))


def enlarged(indices: Indices) -> Indices:
    """Return the plan (X, Y) with each pixel enlarged to a square of `px_per_column`."""
    side_px = px_per_column(indices.shape)
    return indices.repeat(side_px, axis=0).repeat(side_px, axis=1)


def _highest(semantics: Grid) -> NDArray[np.int64]:
    """Return the highest labelled voxel of each column (X, Y), 0 if none: the top bit of a word of Z."""
    words = np.packbits(semantics != 0, axis=2, bitorder="little").view(f"<u{semantics.shape[2] // 8}")[..., 0]
    return np.asarray(np.maximum(np.frexp(words.astype(np.float64))[1] - 1, 0), dtype=np.int64)


def _any_above(observed: Grid) -> NDArray[np.bool_]:
    """Return the columns (X, Y) that have any voxel set; eight voxels are tested per word."""
    words = np.ascontiguousarray(observed).view(np.uint64)
    return np.asarray(words.any(axis=2), dtype=np.bool_)


def _rise(height: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rise in voxels of each column (X, Y) towards a light ahead on the left; 0 next to NaN heights."""
    fall = [np.nan_to_num(height - np.roll(height, -1, axis)) for axis in (0, 1)]
    return -fall[0] - fall[1]


# The labels of a frame in two label sets from above, and their differences. Forward is up, left is left. Each pixel
# shows the worst difference in its column: easier in B (where A is stricter), harder in B, only in one; light grey if
# labelled voxels are equal. Codes are those of `stone/scoring/agreement.py`.


SeenGrid = tuple[Grid, Grid | None]
"""The classes of a frame, and its observed mask if known."""

GRAVITY = (BOTH_FREE, SAME, ONLY_A, ONLY_B, HARDER, EASIER)
PANELS = ("A", "B", "difference")
GAP_PX, HEAD_PX = 16, 28

_RANK = np.argsort(np.array(GRAVITY)).astype(np.uint8)
_INDEX = np.array([GROUND_INDEX if code == BOTH_FREE else DIFFERENCE_INDEX + code for code in GRAVITY], np.uint8)


def comparison_picture(a: SeenGrid, b: SeenGrid) -> bytes:
    """Return a PNG with A, B and the difference side by side, of grids (X, Y, Z)."""
    panels = [enlarged(panel) for panel in (plan_indices(*a), plan_indices(*b), _difference_indices(a[0], b[0]))]
    high_px, wide_px = panels[0].shape
    whole = np.full((high_px + HEAD_PX, len(panels) * wide_px + (len(panels) - 1) * GAP_PX), GROUND_INDEX, np.uint8)
    words, font = Image.new("L", whole.shape[::-1]), ImageFont.load_default(18)
    for index, (name, indices) in enumerate(zip(PANELS, panels, strict=True)):
        left = index * (wide_px + GAP_PX)
        ImageDraw.Draw(words).text((left, 2), name, fill=255, font=font)
        whole[HEAD_PX:, left : left + wide_px] = indices
    return png_of(with_words(whole, words))


def difference_picture(a: Grid, b: Grid) -> bytes:
    """Return a PNG of the differences of two grids (X, Y, Z); transparent if both are free."""
    return png_of(enlarged(_difference_indices(a, b)))


def _difference_indices(a: Grid, b: Grid) -> Indices:
    gravest = _RANK[differences(a, b)].max(axis=2)
    return np.ascontiguousarray(_INDEX[gravest][::-1, ::-1])
