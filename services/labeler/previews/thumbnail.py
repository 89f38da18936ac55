"""`thumbnail.jpg`: the map from above around the robot's track, shown in lists.

**Conventions.** 640 × 400, north up, colours and relief of `services/labeler/previews/map_picture.py`, without words.
All of the track is inside, with a margin; the picture shows at least `LEAST_M` across.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from services.labeler.previews.map_picture import ShadedMap, TopView
from stone.geometry.se3 import SE3
from stone.labels.class_colours import PAPER, TRACK

WIDTH_PX, HEIGHT_PX = 640, 400
LEAST_M, MARGIN_M = 48.0, 8.0
JPEG_QUALITY = 85
FINER = 2
LINE_PX, DOT_PX = 4, 7


def write_thumbnail(path: Path, view: TopView, map_from_ego: SE3) -> None:
    """Draw and save; the folder exists."""
    thumbnail(view, map_from_ego).save(path, "jpeg", quality=JPEG_QUALITY, optimize=True)


def thumbnail(view: TopView, map_from_ego: SE3) -> Image.Image:
    """The picture; the view has some tile and the track some pose."""
    track_m = map_from_ego.translation_m[:, :2]
    centre_m, width_m = _framing(track_m)
    per_m = WIDTH_PX * FINER / width_m
    corner_m = centre_m + np.array([-width_m, width_m * HEIGHT_PX / WIDTH_PX]) / 2  # its upper left
    image = _cropped(view.shaded(), corner_m, width_m)
    line = [((x - corner_m[0]) * per_m, (corner_m[1] - y) * per_m) for x, y in track_m.tolist()]
    _draw_track(ImageDraw.Draw(image), line)
    return image.reduce(FINER)


def _framing(track_m: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """The middle (2,) of what is shown, and how wide it is, metres."""
    low, high = track_m.min(axis=0) - MARGIN_M, track_m.max(axis=0) + MARGIN_M
    across, up = high - low
    return (low + high) / 2, float(max(across, up * WIDTH_PX / HEIGHT_PX, LEAST_M))


def _cropped(whole: ShadedMap, corner_m: NDArray[np.float64], width_m: float) -> Image.Image:
    """The part of the map whose upper left is at `corner_m`, `FINER` times as large as it is shown, paper around it."""
    pixels, low, side_m = whole.pixels, whole.low, whole.side_m
    north_m = (low[1] * side_m) + len(pixels) * side_m
    left, top = (corner_m[0] / side_m - low[0], (north_m - corner_m[1]) / side_m)
    step = width_m / side_m / (WIDTH_PX * FINER)  # map pixels in a pixel of the picture
    size = (WIDTH_PX * FINER, HEIGHT_PX * FINER)
    resample = Image.Resampling.NEAREST if step <= 1 else Image.Resampling.BILINEAR
    return Image.fromarray(pixels).transform(
        size, Image.Transform.AFFINE, (step, 0, left, 0, step, top), resample, fillcolor=PAPER
    )


def _draw_track(pen: ImageDraw.ImageDraw, line: list[tuple[float, float]]) -> None:
    if len(line) > 1:
        pen.line(line, fill=PAPER, width=(LINE_PX + 2) * FINER, joint="curve")
        pen.line(line, fill=TRACK, width=LINE_PX * FINER, joint="curve")
    for (x, y), fill in ((line[0], PAPER), (line[-1], TRACK)):
        radius = DOT_PX * FINER
        pen.ellipse((x - radius, y - radius, x + radius, y + radius), fill=fill, outline=TRACK, width=2 * FINER)
