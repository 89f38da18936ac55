"""The top-down picture of a frame's label grid: forward is up, left is left.

**Conventions.** Per column the highest labelled voxel shows, lit by the relief; grey is what no ray reached, the ground
(transparent, on paper white) what was seen to be free all the way. Pictures are those of
`services/domain/viewer/indexed_pictures.py`.
"""

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from services.domain.viewer.indexed_pictures import (
    CASING_INDEX,
    ROBOT_INDEX,
    UNSEEN_INDEX,
    Indices,
    lit,
    png_of,
    rgb_on_paper,
)

Grid = NDArray[np.uint8]

PX_PER_VOXEL = 2
ROBOT_PX = ((0, -9), (6, 7), (0, 3), (-6, 7))  # an arrowhead that points forward


def picture_bytes(semantics: Grid, observed: Grid) -> bytes:
    """A PNG, 512 × 512, of the grids (256, 256, 32), with the robot in the middle."""
    image = Image.fromarray(enlarged(plan_indices(semantics, observed)))
    middle = np.array(image.size) / 2
    outline = [(float(x), float(y)) for x, y in middle + np.array(ROBOT_PX)]
    ImageDraw.Draw(image).polygon(outline, fill=ROBOT_INDEX, outline=CASING_INDEX)
    return png_of(np.asarray(image))


def plan(semantics: Grid, observed: Grid | None = None) -> Grid:
    """(256, 256, 3) on paper: one pixel per column; with `observed` what was never seen is grey."""
    return rgb_on_paper(plan_indices(semantics, observed))


def plan_indices(semantics: Grid, observed: Grid | None = None) -> Indices:
    """(256, 256): the same as indices of a picture's palette."""
    highest = _highest(semantics)
    kind = np.take_along_axis(semantics, highest[..., None], axis=2)[..., 0]
    shown = lit(kind, _rise(np.where(kind > 0, highest, np.nan)))
    if observed is not None:
        shown[(kind == 0) & ~_any_above(observed)] = UNSEEN_INDEX
    return np.ascontiguousarray(shown[::-1, ::-1])


def enlarged(indices: Indices) -> Indices:
    """Each pixel as a square of `PX_PER_VOXEL` a side."""
    return indices.repeat(PX_PER_VOXEL, axis=0).repeat(PX_PER_VOXEL, axis=1)


def _highest(semantics: Grid) -> NDArray[np.int64]:
    """The highest labelled voxel of each column (256, 256); 0 where none is: the top bit of a word of 32."""
    words = np.packbits(semantics != 0, axis=2, bitorder="little").view("<u4")[..., 0]
    return np.asarray(np.maximum(np.frexp(words.astype(np.float64))[1] - 1, 0), dtype=np.int64)


def _any_above(observed: Grid) -> NDArray[np.bool_]:
    """Which columns (256, 256) hold anything; eight voxels are looked at in one word."""
    words = np.ascontiguousarray(observed).view(np.uint64)
    return np.asarray(words.any(axis=2), dtype=np.bool_)


def _rise(height: NDArray[np.float64]) -> NDArray[np.float64]:
    """By how many voxels each column (256, 256) rises against a light from ahead on the left; 0 beside NaN heights."""
    fall = [np.nan_to_num(height - np.roll(height, -1, axis)) for axis in (0, 1)]
    return -fall[0] - fall[1]
