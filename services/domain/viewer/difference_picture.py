"""The labels of a frame in two label sets from above, and beside them where they differ.

**Conventions.** Forward is up, left is left. Of a column the gravest difference of its voxels shows: easier in B (what
A forbids more), harder in B, only in one; light grey where labelled voxels are all alike. Codes are those of
`stone/scoring/agreement.py`.
"""

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from services.domain.viewer.frame_picture import PX_PER_VOXEL, enlarged, plan_indices
from services.domain.viewer.indexed_pictures import (
    DIFFERENCE_INDEX,
    GROUND_INDEX,
    Indices,
    png_of,
    with_words,
)
from stone.scoring.agreement import BOTH_FREE, EASIER, HARDER, ONLY_A, ONLY_B, SAME, differences

Grid = NDArray[np.uint8]
SeenGrid = tuple[Grid, Grid | None]
"""The classes of a frame, and what was seen of it where that is known."""

GRAVITY = (BOTH_FREE, SAME, ONLY_A, ONLY_B, HARDER, EASIER)
PANELS = ("A", "B", "difference")
GAP_PX, HEAD_PX = 16, 28

_RANK = np.argsort(np.array(GRAVITY)).astype(np.uint8)
_INDEX = np.array([GROUND_INDEX if code == BOTH_FREE else DIFFERENCE_INDEX + code for code in GRAVITY], np.uint8)


def comparison_picture(a: SeenGrid, b: SeenGrid) -> bytes:
    """A PNG: A, B and the difference side by side, 512 px each, of grids (256, 256, 32)."""
    panels = [plan_indices(*a), plan_indices(*b), _difference_indices(a[0], b[0])]
    side_px = panels[0].shape[0] * PX_PER_VOXEL
    whole = np.full((side_px + HEAD_PX, len(panels) * side_px + (len(panels) - 1) * GAP_PX), GROUND_INDEX, np.uint8)
    words, font = Image.new("L", whole.shape[::-1]), ImageFont.load_default(18)
    for place, (name, indices) in enumerate(zip(PANELS, panels, strict=True)):
        left = place * (side_px + GAP_PX)
        ImageDraw.Draw(words).text((left, 2), name, fill=255, font=font)
        whole[HEAD_PX:, left : left + side_px] = enlarged(indices)
    return png_of(with_words(whole, words))


def difference_picture(a: Grid, b: Grid) -> bytes:
    """A PNG of where two grids (256, 256, 32) differ, 512 × 512; transparent where both are free."""
    return png_of(enlarged(_difference_indices(a, b)))


def _difference_indices(a: Grid, b: Grid) -> Indices:
    gravest = _RANK[differences(a, b)].max(axis=2)
    return np.ascontiguousarray(_INDEX[gravest][::-1, ::-1])
