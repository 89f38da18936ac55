"""The labels of a frame in two label sets from above, and beside them where they differ.

**Conventions.** Forward is up, left is left. Of a column the gravest difference of its voxels shows: easier in B (what
A forbids more), harder in B, only in one; light grey where labelled voxels are all alike. Codes are those of
`stone/scoring/agreement.py`.
"""

import io

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from services.domain.viewer.frame_picture import PX_PER_VOXEL, plan
from stone.labels.class_colours import INK, PAPER
from stone.scoring.agreement import BOTH_FREE, EASIER, HARDER, ONLY_A, ONLY_B, SAME, differences

Grid = NDArray[np.uint8]
SeenGrid = tuple[Grid, Grid | None]
"""The classes of a frame, and what was seen of it where that is known."""

DIFFERENCE_RGB = {
    BOTH_FREE: PAPER,
    SAME: (206, 206, 202),
    ONLY_A: (86, 180, 233),
    ONLY_B: (230, 159, 0),
    EASIER: (150, 20, 20),
    HARDER: (20, 60, 150),
}
GRAVITY = (BOTH_FREE, SAME, ONLY_A, ONLY_B, HARDER, EASIER)
PANELS = ("A", "B", "difference")
GAP_PX, HEAD_PX = 16, 28

_RANK = np.argsort(np.array(GRAVITY)).astype(np.uint8)
_COLOUR = np.array([DIFFERENCE_RGB[code] for code in GRAVITY], np.uint8)


def comparison_picture(a: SeenGrid, b: SeenGrid) -> bytes:
    """A PNG: A, B and the difference side by side, 512 px each, of grids (256, 256, 32)."""
    panels = [plan(*a), plan(*b), difference_plan(a[0], b[0])]
    side_px = panels[0].shape[0] * PX_PER_VOXEL
    size = (len(panels) * side_px + (len(panels) - 1) * GAP_PX, side_px + HEAD_PX)
    image, font = Image.new("RGB", size, PAPER), ImageFont.load_default(18)
    draw = ImageDraw.Draw(image)
    for place, (name, pixels) in enumerate(zip(PANELS, panels, strict=True)):
        left = place * (side_px + GAP_PX)
        draw.text((left, 2), name, fill=INK, font=font)
        panel = Image.fromarray(pixels).resize((side_px, side_px), Image.Resampling.NEAREST)
        image.paste(panel, (left, HEAD_PX))
    file = io.BytesIO()
    image.save(file, "PNG", compress_level=3)
    return file.getvalue()


def difference_plan(a: Grid, b: Grid) -> Grid:
    """(256, 256, 3): one pixel per column, of its gravest difference. Raises `ShapeError`."""
    gravest = _RANK[differences(a, b)].max(axis=2)
    return np.ascontiguousarray(_COLOUR[gravest][::-1, ::-1])
