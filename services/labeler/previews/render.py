"""Labelled voxels as shaded boxes in perspective: a small renderer that needs no graphics card.

**Conventions.** Boxes are axis-aligned in one world frame, z up. A `Canvas` is drawn on piece by piece, in any order:
the z-buffer keeps what is nearest. It is drawn `FINER` times as fine as it is shown, which smooths the edges.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from services.labeler.previews.render_kernels import draw, expose
from stone.labels.class_colours import CLASS_RGB, PAPER
from stone.labels.voxels import VOXEL_M
from stone.sensors.calibration import Box

FINER = 2
ALL_SIDES = 0b111111
PALETTE = np.array([PAPER, *(CLASS_RGB[c] for c in (1, 2, 3))], np.uint8)
SOLID_LIGHT = np.array([0.80, 0.92, 0.66, 0.72, 0.50, 1.00], np.float32)

Colour = tuple[int, int, int]


@dataclass(frozen=True, eq=False)
class Boxes:
    """N boxes: `bounds_m` (N, 6) low then high corner, `sides` (N,) that may show, `light` (N, 6), `rgb` (N, 3)."""

    bounds_m: NDArray[np.float32]
    sides: NDArray[np.uint8]
    light: NDArray[np.float32]
    rgb: NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole at `eye_m` (3,) that looks at a place; z stays up. The eye is not straight above what it looks at."""

    eye_m: NDArray[np.float64]
    target_m: NDArray[np.float64]
    view_rad: float

    def matrix(self) -> NDArray[np.float64]:
        """`camera_from_world` (3, 4): x right, y down, z forward."""
        forward = (self.target_m - self.eye_m) / np.linalg.norm(self.target_m - self.eye_m)
        right = np.cross(forward, (0.0, 0.0, 1.0))
        right /= np.linalg.norm(right)
        turn = np.stack([right, np.cross(forward, right), forward])
        return np.column_stack([turn, -turn @ self.eye_m])


class Canvas:
    """A picture of `width_px` × `height_px` that boxes are drawn on."""

    def __init__(self, camera: Camera, width_px: int, height_px: int) -> None:
        shape = (height_px * FINER, width_px * FINER)
        self._pixels = np.full((*shape, 3), PAPER, np.uint8)
        self._nearness = np.zeros(shape, np.float32)
        focal_px = shape[1] / 2 / np.tan(camera.view_rad / 2)
        lens = np.array([focal_px, shape[1] / 2, shape[0] / 2])
        self._camera = (camera.matrix(), camera.eye_m.astype(np.float64), lens)

    def add(self, boxes: Boxes) -> None:
        """Draw these too; boxes that reach behind the camera are left out."""
        draw((boxes.bounds_m, boxes.sides, boxes.light, boxes.rgb), self._camera, self._pixels, self._nearness)

    def image(self) -> Image.Image:
        """What is drawn so far, smoothed."""
        return Image.fromarray(self._pixels).reduce(FINER)


def voxel_boxes(classes: NDArray[np.uint8], low_m: NDArray[np.float64]) -> Boxes:
    """The labelled voxels of a dense block (X, Y, Z) whose corner is at `low_m` (3,), in the colours of the classes."""
    flat = np.flatnonzero(classes)
    sides, light = np.zeros(len(flat), np.uint8), np.zeros((len(flat), 6), np.float32)
    expose(classes, flat, sides, light)
    shown = sides != 0
    flat, sides, light = flat[shown], sides[shown], light[shown]
    low = np.stack(np.unravel_index(flat, classes.shape), axis=1) * VOXEL_M + low_m
    bounds = np.concatenate([low, low + VOXEL_M], axis=1).astype(np.float32)
    return Boxes(bounds, sides, light, PALETTE[classes.reshape(-1)[flat]])


def solid_boxes(boxes: list[Box], colour: Colour) -> Boxes:
    """Boxes of one colour."""
    bounds = np.array([(*box.min_m, *box.max_m) for box in boxes], np.float32).reshape(-1, 6)
    return beads(bounds, colour)


def beads(bounds_m: NDArray[np.float32], colour: Colour) -> Boxes:
    """Boxes (N, 6) of one colour, lit from above."""
    count = len(bounds_m)
    rgb = np.broadcast_to(np.array(colour, np.uint8), (count, 3)).copy()
    light = np.broadcast_to(SOLID_LIGHT, (count, 6)).copy()
    return Boxes(np.ascontiguousarray(bounds_m, np.float32), np.full(count, ALL_SIDES, np.uint8), light, rgb)
