"""`bev.png`: the labelled map from above, coloured by class, shaded by relief, with the robot's track.

**Conventions.** x to the right, y up. Each pixel shows the highest labelled voxel of its column. Pictures are those of
`services/domain/viewer/frame_picture.py` with a transparent background.
"""

from dataclasses import dataclass
from math import ceil, sqrt
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from services.domain.viewer.frame_picture import (
    CASING_INDEX,
    GROUND_INDEX,
    OPAQUE_INDEX,
    TRACK_INDEX,
    Indices,
    lit,
    of_class,
    png_of,
    with_words,
)
from stone.geometry.corners import corners_of
from stone.geometry.lattice import Keys, indices_of
from stone.geometry.se3 import SE3
from stone.labels.class_colours import CLASS_NAME
from stone.labels.voxels import VOXEL_M

MARGIN_PX, LEGEND_PX, MAX_SIDE_PX, MIN_SIDE_PX = 16, 44, 4000, 900
MOST_PIXELS = 4_000_000  # before scaling: parts of a map may be as far apart as poses


@dataclass(frozen=True, eq=False)
class ShadedMap:
    """`indices` (Y, X), north up, with pixels of `side_m`; `low` (2,) is the lowest x and y in such pixels."""

    indices: Indices
    low: NDArray[np.int64]
    side_m: float


@dataclass
class TopView:
    """Collects the highest voxel of every column tile by tile; `draw` makes the picture."""

    columns: dict[tuple[int, int], tuple[NDArray[np.int64], NDArray[np.uint8]]]

    def add(self, tile: tuple[int, int], keys: Keys, classes: NDArray[np.uint8]) -> None:
        """Add the voxels (K,) of one tile; tiles share no column."""
        if len(keys):
            indices = indices_of(keys)
            last = np.append((np.diff(indices[:, :2], axis=0) != 0).any(axis=1), True)  # keys sort z lowest
            self.columns[tile] = (indices[last], classes[last])

    def draw(self, map_from_ego: SE3) -> Indices:
        """Return the picture, at least `MIN_SIDE_PX` and at most about `MAX_SIDE_PX` a side."""
        whole = self.shaded()
        image = Image.fromarray(whole.indices)
        scale = _scale(max(image.size))
        side = (max(1, round(image.width * scale)), max(1, round(image.height * scale)))
        image = image.resize(side, Image.Resampling.NEAREST)
        track = (map_from_ego.translation_m[:, :2] / whole.side_m - whole.low) * scale
        return _add_frame(image, np.stack([track[:, 0], side[1] - track[:, 1]], axis=1), scale / whole.side_m)

    def shaded(self) -> ShadedMap:
        """Return a pixel per column, or per square of columns beyond `MOST_PIXELS`; there is at least one tile."""
        indices = np.concatenate([part[0] for part in self.columns.values()])
        classes = np.concatenate([part[1] for part in self.columns.values()])
        low, last = corners_of(indices[:, :2])
        size = last - low + 1
        step = ceil(sqrt(float(size[0]) * float(size[1]) / MOST_PIXELS))
        if step > 1:
            order = np.argsort(indices[:, 2], kind="stable")  # a square shows its highest column
            indices, classes = indices[order] // step, classes[order]
            low, size = low // step, indices[:, :2].max(axis=0) - low // step + 1
        return ShadedMap(_shade(indices - np.append(low, 0), classes, size), low, VOXEL_M * step)


def write_top_view(path: Path, view: TopView, map_from_ego: SE3) -> None:
    """Draw and save; the folder exists."""
    path.write_bytes(png_of(view.draw(map_from_ego), compress_level=9))


def _scale(side: int) -> float:
    """Return pixels per voxel: whole when enlarging, so that voxels stay square."""
    if side > MAX_SIDE_PX:
        return MAX_SIDE_PX / side
    return float(max(1, round(MIN_SIDE_PX / side)))


def _shade(indices: NDArray[np.int64], classes: NDArray[np.uint8], size: NDArray[np.int64]) -> Indices:
    """Return (Y, X), north up: classes, lit from the north-west by the relief of the top voxels."""
    top = np.full((size[1], size[0]), np.nan)
    kind = np.zeros((size[1], size[0]), np.uint8)
    rows, columns = size[1] - 1 - indices[:, 1], indices[:, 0]
    top[rows, columns], kind[rows, columns] = indices[:, 2], classes
    down, right = (np.nan_to_num(np.diff(top, axis=axis, append=np.nan)) for axis in (0, 1))
    return lit(kind, down + right)


def _add_frame(image: Image.Image, track: NDArray[np.float64], px_per_m: float) -> Indices:
    """Return the map with the track, its start, a legend and a scale bar."""
    width = max(image.width, 620) + 2 * MARGIN_PX
    sheet = Image.new("L", (width, image.height + 2 * MARGIN_PX + LEGEND_PX), GROUND_INDEX)
    sheet.paste(image, (MARGIN_PX, MARGIN_PX))
    pen = ImageDraw.Draw(sheet)
    draw_line(pen, [(float(x) + MARGIN_PX, float(y) + MARGIN_PX) for x, y in track], width_px=3)
    for (x, y), radius in ((track[0] + MARGIN_PX, 6), (track[-1] + MARGIN_PX, 4)):
        pen.ellipse((x - radius, y - radius, x + radius, y + radius), fill=TRACK_INDEX, outline=CASING_INDEX, width=1)
    words = Image.new("L", sheet.size)
    _legend((pen, ImageDraw.Draw(words)), image.height + 2 * MARGIN_PX, px_per_m)
    return with_words(np.asarray(sheet), words)


def draw_line(pen: ImageDraw.ImageDraw, points: list[tuple[float, float]], width_px: int) -> None:
    """Draw a track with an outline, which separates it from dark labels and from a dark page."""
    if len(points) > 1:
        pen.line(points, fill=CASING_INDEX, width=width_px + 2, joint="curve")
        pen.line(points, fill=TRACK_INDEX, width=width_px, joint="curve")


def _legend(pens: tuple[ImageDraw.ImageDraw, ImageDraw.ImageDraw], top: int, px_per_m: float) -> None:
    """Draw the legend with the pen of the picture and the pen of its text."""
    (pen, writing), font = pens, ImageFont.load_default(size=14)
    x = float(MARGIN_PX)
    for kind, name in CLASS_NAME.items():
        pen.rectangle((x, top, x + 14, top + 14), fill=of_class(kind))
        writing.text((x + 20, top - 2), name, fill=255, font=font)
        x += 34 + writing.textlength(name, font=font)
    draw_line(pen, [(x, top + 7), (x + 20, top + 7)], width_px=3)
    writing.text((x + 26, top - 2), "track", fill=255, font=font)
    x += 84
    bar_m = next((m for m in (100, 50, 20, 10, 5, 2) if m * px_per_m <= 120), 1)
    pen.line((x, top + 7, x + bar_m * px_per_m, top + 7), fill=OPAQUE_INDEX, width=2)
    writing.text((x + bar_m * px_per_m + 6, top - 2), f"{bar_m} m", fill=255, font=font)
