"""The top-down picture of a frame's label grid: forward is up, left is left.

**Conventions.** Per column the highest labelled voxel shows, lit by the relief; grey is what no ray reached, white what
was seen to be free all the way.
"""

import io

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from stone.labels.class_colours import CLASS_RGB, INK, PAPER, UNSEEN

Grid = NDArray[np.uint8]

PALETTE = np.array([PAPER, *(CLASS_RGB[c] for c in (1, 2, 3))], np.uint8)
RELIEF, LEAST_LIGHT, MOST_LIGHT = 0.09, 0.62, 1.18
PX_PER_VOXEL = 2
ROBOT_PX = ((0, -9), (6, 7), (0, 3), (-6, 7))  # an arrowhead that points forward


def picture_bytes(semantics: Grid, observed: Grid) -> bytes:
    """A PNG, 512 × 512, of the grids (256, 256, 32), with the robot in the middle."""
    pixels = plan(semantics, observed)
    side = (pixels.shape[1] * PX_PER_VOXEL, pixels.shape[0] * PX_PER_VOXEL)
    image = Image.fromarray(pixels).resize(side, Image.Resampling.NEAREST)
    middle = np.array(side) / 2
    outline = [(float(x), float(y)) for x, y in middle + np.array(ROBOT_PX)]
    ImageDraw.Draw(image).polygon(outline, fill=INK, outline=PAPER)
    file = io.BytesIO()
    image.save(file, "PNG", compress_level=3)
    return file.getvalue()


def plan(semantics: Grid, observed: Grid | None = None) -> Grid:
    """(256, 256, 3): one pixel per column; with `observed` what was never seen is grey."""
    highest = _highest(semantics)
    kind = np.take_along_axis(semantics, highest[..., None], axis=2)[..., 0]
    colour = PALETTE[kind] * _light(np.where(kind > 0, highest, np.nan))[..., None]
    if observed is not None:
        colour[(kind == 0) & ~_any_above(observed)] = UNSEEN
    return np.ascontiguousarray(np.clip(colour + 0.5, 0, 255).astype(np.uint8)[::-1, ::-1])


def _highest(semantics: Grid) -> NDArray[np.int64]:
    """The highest labelled voxel of each column (256, 256); 0 where none is: the top bit of a word of 32."""
    words = np.packbits(semantics != 0, axis=2, bitorder="little").view("<u4")[..., 0]
    return np.asarray(np.maximum(np.frexp(words.astype(np.float64))[1] - 1, 0), dtype=np.int64)


def _any_above(observed: Grid) -> NDArray[np.bool_]:
    """Which columns (256, 256) hold anything; eight voxels are looked at in one word."""
    words = np.ascontiguousarray(observed).view(np.uint64)
    return np.asarray(words.any(axis=2), dtype=np.bool_)


def _light(height: NDArray[np.float64]) -> NDArray[np.float64]:
    """The brightness of each column (256, 256), lit from ahead on the left; NaN heights are lit evenly."""
    rise = [np.nan_to_num(height - np.roll(height, -1, axis)) for axis in (0, 1)]
    light = np.clip(1.0 + RELIEF * np.clip(-rise[0] - rise[1], -4, 4), LEAST_LIGHT, MOST_LIGHT)
    return np.where(np.isnan(height), 1.0, light)
