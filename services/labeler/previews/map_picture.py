"""`bev.png`: the labelled map from above, coloured by class, shaded by relief, with the robot's track.

**Conventions.** x to the right, y up; per column the highest labelled voxel shows. Colours are those of
`stone/labels/class_colours.py`.
"""

from dataclasses import dataclass
from math import ceil, sqrt
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from stone.geometry.lattice import Keys, indices_of
from stone.geometry.se3 import SE3
from stone.labels.class_colours import CLASS_NAME, CLASS_RGB, INK, PAPER, TRACK
from stone.labels.voxels import VOXEL_M

MARGIN_PX, LEGEND_PX, MAX_SIDE_PX, MIN_SIDE_PX = 16, 44, 4000, 900
MOST_PIXELS = 4_000_000  # of a map before it is scaled: two parts of it may lie as far apart as poses can


@dataclass(frozen=True, eq=False)
class ShadedMap:
    """`pixels` (Y, X, 3), north up, of `side_m` each; `low` (2,) is the lowest place in x and y, in such sides."""

    pixels: NDArray[np.uint8]
    low: NDArray[np.int64]
    side_m: float


@dataclass
class TopView:
    """Collects tile after tile the highest voxel of every column; `draw` makes the picture."""

    columns: dict[tuple[int, int], tuple[NDArray[np.int64], NDArray[np.uint8]]]

    def add(self, tile: tuple[int, int], keys: Keys, classes: NDArray[np.uint8]) -> None:
        """The voxels (K,) of one tile; no column is shared between tiles."""
        if len(keys):
            indices = indices_of(keys)
            last = np.append((np.diff(indices[:, :2], axis=0) != 0).any(axis=1), True)  # keys sort z lowest
            self.columns[tile] = (indices[last], classes[last])

    def draw(self, map_from_ego: SE3) -> Image.Image:
        """The picture, at least `MIN_SIDE_PX` and at most about `MAX_SIDE_PX` a side."""
        whole = self.shaded()
        image = Image.fromarray(whole.pixels)
        scale = _scale(max(image.size))
        side = (max(1, round(image.width * scale)), max(1, round(image.height * scale)))
        image = image.resize(side, Image.Resampling.NEAREST if scale >= 1 else Image.Resampling.BOX)
        track = (map_from_ego.translation_m[:, :2] / whole.side_m - whole.low) * scale
        return _framed(image, np.stack([track[:, 0], side[1] - track[:, 1]], axis=1), scale / whole.side_m)

    def shaded(self) -> ShadedMap:
        """A pixel a column, or a square of them where there would be more than `MOST_PIXELS`; there is some tile."""
        indices = np.concatenate([part[0] for part in self.columns.values()])
        classes = np.concatenate([part[1] for part in self.columns.values()])
        low = indices[:, :2].min(axis=0)
        size = indices[:, :2].max(axis=0) - low + 1
        step = ceil(sqrt(float(size[0]) * float(size[1]) / MOST_PIXELS))
        if step > 1:
            order = np.argsort(indices[:, 2], kind="stable")  # of a square the highest column shows
            indices, classes = indices[order] // step, classes[order]
            low, size = low // step, indices[:, :2].max(axis=0) - low // step + 1
        return ShadedMap(_shaded(indices - np.append(low, 0), classes, size), low, VOXEL_M * step)


def write_top_view(path: Path, view: TopView, map_from_ego: SE3) -> None:
    """Draw and save; the folder exists."""
    view.draw(map_from_ego).save(path, "png", optimize=True)


def _scale(side: int) -> float:
    """Pixels per voxel: whole while enlarging, so that voxels stay square."""
    if side > MAX_SIDE_PX:
        return MAX_SIDE_PX / side
    return float(max(1, round(MIN_SIDE_PX / side)))


def _shaded(indices: NDArray[np.int64], classes: NDArray[np.uint8], size: NDArray[np.int64]) -> NDArray[np.uint8]:
    """(Y, X, 3) uint8, north up: class colour, lit from the north-west by the relief of the top voxels."""
    top = np.full((size[1], size[0]), np.nan)
    kind = np.zeros((size[1], size[0]), np.uint8)
    rows, columns = size[1] - 1 - indices[:, 1], indices[:, 0]
    top[rows, columns], kind[rows, columns] = indices[:, 2], classes
    palette = np.array([PAPER, *(CLASS_RGB[c] for c in (1, 2, 3))], np.float64)
    down, right = (np.nan_to_num(np.diff(top, axis=axis, append=np.nan)) for axis in (0, 1))
    light = np.clip(1.0 + 0.09 * np.clip(down + right, -4, 4), 0.6, 1.25)
    light[kind == 0] = 1.0
    lit = palette[kind]
    lit *= light[..., None]
    return np.clip(lit, 0, 255, out=lit).astype(np.uint8)


def _framed(image: Image.Image, track: NDArray[np.float64], px_per_m: float) -> Image.Image:
    """The map on paper with the track, its start, a legend and a scale bar."""
    width = max(image.width, 620) + 2 * MARGIN_PX
    sheet = Image.new("RGB", (width, image.height + 2 * MARGIN_PX + LEGEND_PX), PAPER)
    sheet.paste(image, (MARGIN_PX, MARGIN_PX))
    pen = ImageDraw.Draw(sheet)
    points = [(float(x) + MARGIN_PX, float(y) + MARGIN_PX) for x, y in track]
    if len(points) > 1:
        pen.line(points, fill=TRACK, width=3, joint="curve")
    for (x, y), radius in ((points[0], 6), (points[-1], 4)):
        pen.ellipse((x - radius, y - radius, x + radius, y + radius), fill=TRACK, outline=PAPER, width=1)
    _legend(pen, image.height + 2 * MARGIN_PX, px_per_m)
    return sheet


def _legend(pen: ImageDraw.ImageDraw, top: int, px_per_m: float) -> None:
    font = ImageFont.load_default(size=14)
    x = float(MARGIN_PX)
    for kind, name in CLASS_NAME.items():
        pen.rectangle((x, top, x + 14, top + 14), fill=CLASS_RGB[kind])
        pen.text((x + 20, top - 2), name, fill=INK, font=font)
        x += 34 + pen.textlength(name, font=font)
    pen.line((x, top + 7, x + 20, top + 7), fill=TRACK, width=3)
    pen.text((x + 26, top - 2), "track", fill=INK, font=font)
    x += 84
    bar_m = next((m for m in (100, 50, 20, 10, 5, 2) if m * px_per_m <= 120), 1)
    pen.line((x, top + 7, x + bar_m * px_per_m, top + 7), fill=INK, width=2)
    pen.text((x + bar_m * px_per_m + 6, top - 2), f"{bar_m} m", fill=INK, font=font)
