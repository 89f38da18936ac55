"""`thumbnail.png`: the map from above around the robot's track, shown in lists.

**Conventions.** 640 × 400, north up, an indexed picture as in `services/labeler/previews/map_picture.py`, without text.
The picture contains the whole track with a margin, and shows at least `LEAST_M` across.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from services.domain.viewer.frame_picture import CASING_INDEX, GROUND_INDEX, TRACK_INDEX, Indices, png_of
from services.labeler.previews.map_picture import ShadedMap, TopView, draw_line
from stone.geometry.se3 import SE3

WIDTH_PX, HEIGHT_PX = 640, 400
LEAST_M, MARGIN_M = 48.0, 8.0
LINE_PX, DOT_PX = 4, 7


def write_thumbnail(path: Path, view: TopView, map_from_ego: SE3) -> None:
    """Draw and save; the folder exists."""
    path.write_bytes(png_of(thumbnail(view, map_from_ego), compress_level=9))


def thumbnail(view: TopView, map_from_ego: SE3) -> Indices:
    """Return the picture; the view has at least one tile and the track at least one pose."""
    track_m = map_from_ego.translation_m[:, :2]
    centre_m, width_m = _framing(track_m)
    per_m = WIDTH_PX / width_m
    corner_m = centre_m + np.array([-width_m, width_m * HEIGHT_PX / WIDTH_PX]) / 2  # its upper left
    image = _crop_map(view.shaded(), corner_m, width_m)
    line = [((x - corner_m[0]) * per_m, (corner_m[1] - y) * per_m) for x, y in track_m.tolist()]
    _draw_track(ImageDraw.Draw(image), line)
    return np.asarray(image)


def _framing(track_m: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Return the middle (2,) and the width of the shown area, metres."""
    low, high = track_m.min(axis=0) - MARGIN_M, track_m.max(axis=0) + MARGIN_M
    across, up = high - low
    return (low + high) / 2, float(max(across, up * WIDTH_PX / HEIGHT_PX, LEAST_M))


def _crop_map(whole: ShadedMap, corner_m: NDArray[np.float64], width_m: float) -> Image.Image:
    """Return the part of the map with its upper left at `corner_m`, surrounded by background."""
    indices, low, side_m = whole.indices, whole.low, whole.side_m
    north_m = (low[1] * side_m) + len(indices) * side_m
    left, top = (corner_m[0] / side_m - low[0], (north_m - corner_m[1]) / side_m)
    step = width_m / side_m / WIDTH_PX  # map pixels per pixel of the picture
    return Image.fromarray(indices).transform(
        (WIDTH_PX, HEIGHT_PX),
        Image.Transform.AFFINE,
        (step, 0, left, 0, step, top),
        Image.Resampling.NEAREST,
        fillcolor=GROUND_INDEX,
    )


def _draw_track(pen: ImageDraw.ImageDraw, line: list[tuple[float, float]]) -> None:
    draw_line(pen, line, LINE_PX)
    for (x, y), fill, outline in ((line[0], CASING_INDEX, TRACK_INDEX), (line[-1], TRACK_INDEX, CASING_INDEX)):
        pen.ellipse((x - DOT_PX, y - DOT_PX, x + DOT_PX, y + DOT_PX), fill=fill, outline=outline, width=2)
