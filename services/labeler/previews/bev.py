"""The label grid of one frame from above: forward is up, left is left.

**Conventions.** Per column the highest labelled voxel shows, lit by the relief; grey is what no ray reached, white what
was seen to be free all the way. Rings are 10 and 20 m from the robot.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from services.domain.viewer.frame_picture import plan
from services.labeler.previews.lettering import font
from services.labeler.previews.surroundings import ALONE, Surroundings, runs_inside
from stone.labels.class_colours import INK, PAPER, TRACK
from stone.labels.grid import GRID_MAX_M, GRID_MIN_M, Grid

SIDE_PX = 800
RING = (120, 124, 130)
RINGS_M = (10, 20)
FINER = 2


def bev(grids: Mapping[str, Grid], around: Surroundings = ALONE, side_px: int = SIDE_PX) -> Image.Image:
    """A square picture of `semantics`; with `mask_lidar` what was never seen is grey."""
    fine_px = side_px * FINER
    image = Image.fromarray(plan(grids["semantics"], grids.get("mask_lidar"))).resize(
        (fine_px, fine_px), Image.Resampling.NEAREST
    )
    pen = ImageDraw.Draw(image)
    for radius_m in RINGS_M:
        _ring(pen, radius_m, fine_px)
    for run in runs_inside(around.track_ego):
        width_px = max(2, round(fine_px / 220))
        for colour, wider_px in ((PAPER, 2 * FINER), (TRACK, 0)):
            pen.line(_pixels(run, fine_px), fill=colour, width=width_px + wider_px, joint="curve")
    x, y = around.footprint.length_m / 2, around.footprint.width_m / 2
    outline = np.array([(x, y), (x, -y), (-x, -y), (-x, y)])
    pen.polygon(_pixels(outline, fine_px), fill=INK)
    pen.polygon(_pixels(np.array([(x, 0.0), (0.1, -0.6 * y), (0.1, 0.6 * y)]), fine_px), fill=(245, 245, 245))
    return image.reduce(FINER)


def _ring(pen: ImageDraw.ImageDraw, radius_m: int, side_px: int) -> None:
    x, y = _pixels(np.zeros((1, 2)), side_px)[0]
    radius = radius_m * side_px / (GRID_MAX_M[0] - GRID_MIN_M[0])
    pen.ellipse((x - radius, y - radius, x + radius, y + radius), outline=RING, width=max(2, side_px // 500))
    size, aside = max(20, side_px // 36), radius * 0.7071
    halo = {"stroke_width": size // 7, "stroke_fill": PAPER}
    pen.text((x + aside, y - aside), f"{radius_m} m", INK, font(size), anchor="mm", **halo)  # type: ignore[arg-type]


def _pixels(points_ego: NDArray[np.float64], side_px: int) -> list[tuple[float, float]]:
    """Where points (P, 2 or 3) are in the picture."""
    scale = side_px / (GRID_MAX_M[0] - GRID_MIN_M[0])
    across, down = (GRID_MAX_M[1] - points_ego[:, 1]) * scale, (GRID_MAX_M[0] - points_ego[:, 0]) * scale
    return list(zip(across.tolist(), down.tolist(), strict=True))
