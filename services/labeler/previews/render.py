"""Labelled voxels as shaded boxes in perspective: a small renderer that needs no graphics card.

**Conventions.** Boxes are axis-aligned in one world frame, z up. They are drawn on a `Canvas` piece by piece, in any
order: the z-buffer keeps the nearest. The canvas is `FINER` times finer than the result, which smooths the edges.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from PIL import Image

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
    """N boxes: `bounds_m` (N, 6) low then high corner, visible `sides` (N,), `light` (N, 6), `rgb` (N, 3)."""

    bounds_m: NDArray[np.float32]
    sides: NDArray[np.uint8]
    light: NDArray[np.float32]
    rgb: NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole at `eye_m` (3,) that looks at a target, not from straight above; z is up."""

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
    """A picture of `width_px` × `height_px` on which boxes are drawn."""

    def __init__(self, camera: Camera, width_px: int, height_px: int) -> None:
        shape = (height_px * FINER, width_px * FINER)
        self._pixels = np.full((*shape, 3), PAPER, np.uint8)
        self._nearness = np.zeros(shape, np.float32)
        focal_px = shape[1] / 2 / np.tan(camera.view_rad / 2)
        lens = np.array([focal_px, shape[1] / 2, shape[0] / 2])
        self._camera = (camera.matrix(), camera.eye_m.astype(np.float64), lens)

    def add(self, boxes: Boxes) -> None:
        """Draw boxes; boxes that extend behind the camera are left out."""
        draw((boxes.bounds_m, boxes.sides, boxes.light, boxes.rgb), self._camera, self._pixels, self._nearness)

    def image(self) -> Image.Image:
        """Return the smoothed picture."""
        return Image.fromarray(self._pixels).reduce(FINER)


def voxel_boxes(classes: NDArray[np.uint8], low_m: NDArray[np.float64], voxel_m: float = VOXEL_M) -> Boxes:
    """Return the labelled voxels of a dense block (X, Y, Z) with corner `low_m` (3,), in the class colours."""
    flat = np.flatnonzero(classes)
    sides, light = np.zeros(len(flat), np.uint8), np.zeros((len(flat), 6), np.float32)
    expose(classes, flat, sides, light)
    shown = sides != 0
    flat, sides, light = flat[shown], sides[shown], light[shown]
    low = np.stack(np.unravel_index(flat, classes.shape), axis=1) * voxel_m + low_m
    bounds = np.concatenate([low, low + voxel_m], axis=1).astype(np.float32)
    return Boxes(bounds, sides, light, PALETTE[classes.reshape(-1)[flat]])


def solid_boxes(boxes: list[Box], colour: Colour) -> Boxes:
    """Return boxes of one colour."""
    bounds = np.array([(*box.min_m, *box.max_m) for box in boxes], np.float32).reshape(-1, 6)
    return beads(bounds, colour)


def beads(bounds_m: NDArray[np.float32], colour: Colour) -> Boxes:
    """Return boxes (N, 6) of one colour, lit from above."""
    count = len(bounds_m)
    rgb = np.broadcast_to(np.array(colour, np.uint8), (count, 3)).copy()
    light = np.broadcast_to(SOLID_LIGHT, (count, 6)).copy()
    return Boxes(np.ascontiguousarray(bounds_m, np.float32), np.full(count, ALL_SIDES, np.uint8), light, rgb)


# Axis-aligned boxes into pixels: visible sides, their light, and a z-buffer. Sides are numbered −x, +x, −y, +y, −z, +z;
# bit s of `sides` marks side s as visible. A camera is the 3 × 4 matrix `camera_from_world` (x right, y down, z
# forward), its eye in the world and (focal, centre x, centre y) in pixels. Nearness is 1/z, which is affine over a
# plane's image; 0 is empty. A pixel belongs to a side if its centre is within it or on its edge, so neighbours leave no
# gaps.

# Corner c of a box has high x if bit 0 of c is set, high y if bit 1 is, high z if bit 2 is. A side lists its corners
# in order.
ROUND = np.array([[0, 2, 6, 4], [1, 3, 7, 5], [0, 1, 5, 4], [2, 3, 7, 6], [0, 1, 3, 2], [4, 5, 7, 6]], np.int64)
SIDE_LIGHT = np.array([0.92, 0.89, 0.84, 0.87, 0.82, 1.00])  # never dark enough to resemble another class
SHADE = 0.17  # share of the light lost if all eight voxels around the outer face block it
NEAREST_M = 0.3


@njit(inline="always")
def _is_taken(voxels, i, j, k):  # type: ignore[no-untyped-def]
    inside = 0 <= i < voxels.shape[0] and 0 <= j < voxels.shape[1] and 0 <= k < voxels.shape[2]
    return inside and voxels[i, j, k] != 0


@njit(cache=True, nogil=True)
def expose(voxels, flat, sides, light):  # type: ignore[no-untyped-def]
    """Set the `sides` (N,) of each voxel of `flat` (N,) that face a free voxel, and their `light` (N, 6), 0 to 1."""
    step_i, step_j = voxels.shape[1] * voxels.shape[2], voxels.shape[2]
    for n in range(flat.size):
        i, rest = flat[n] // step_i, flat[n] % step_i
        j, k = rest // step_j, rest % step_j
        for side in range(6):
            axis, way = side >> 1, 2 * (side & 1) - 1
            oi, oj, ok = i + way * (axis == 0), j + way * (axis == 1), k + way * (axis == 2)
            if _is_taken(voxels, oi, oj, ok):
                continue
            sides[n] |= np.uint8(1 << side)
            around = 0
            for a in range(-1, 2):
                for b in range(-1, 2):
                    if axis == 0:
                        around += _is_taken(voxels, oi, oj + a, ok + b)
                    elif axis == 1:
                        around += _is_taken(voxels, oi + a, oj, ok + b)
                    else:
                        around += _is_taken(voxels, oi + a, oj + b, ok)
            light[n, side] = SIDE_LIGHT[side] * (1.0 - SHADE * around / 8.0)


@njit(cache=True, nogil=True)
def draw(boxes, camera, image, nearness):  # type: ignore[no-untyped-def]
    """Draw the boxes (bounds (N, 6) low then high, sides, light, rgb) into `image` (H, W, 3) over `nearness` (H, W)."""
    bounds, sides, light, rgb = boxes
    matrix, eye, lens = camera
    corners = np.empty((8, 3))
    quad = np.empty((4, 3))
    for n in range(bounds.shape[0]):
        shows = sides[n] & _facing(bounds[n], eye)
        if shows == 0 or not _project(bounds[n], matrix, lens, corners):
            continue
        for side in range(6):
            if not (shows >> side) & 1:
                continue
            for c in range(4):
                for axis in range(3):
                    quad[c, axis] = corners[ROUND[side, c], axis]
            red, green, blue = rgb[n, 0], rgb[n, 1], rgb[n, 2]
            lit = light[n, side]
            _fill(quad, (red * lit, green * lit, blue * lit), image, nearness)


@njit(inline="always")
def _facing(bounds, eye):  # type: ignore[no-untyped-def]
    """Return the sides that face the eye."""
    facing = 0
    for axis in range(3):
        facing |= (eye[axis] < bounds[axis]) << (2 * axis)
        facing |= (eye[axis] > bounds[axis + 3]) << (2 * axis + 1)
    return np.uint8(facing)


@njit(inline="always")
def _project(bounds, matrix, lens, corners):  # type: ignore[no-untyped-def]
    """Set pixel x, y and nearness of the eight corners; return False if a corner is not in front of the camera."""
    for c in range(8):
        x, y, z = bounds[3 * (c & 1)], bounds[1 + 3 * ((c >> 1) & 1)], bounds[2 + 3 * ((c >> 2) & 1)]
        depth = matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2] * z + matrix[2, 3]
        if depth < NEAREST_M:
            return False
        near = 1.0 / depth
        corners[c, 0] = lens[1] + lens[0] * near * (
            matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2] * z + matrix[0, 3]
        )
        corners[c, 1] = lens[2] + lens[0] * near * (
            matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2] * z + matrix[1, 3]
        )
        corners[c, 2] = near
    return True


@njit(inline="always")
def _fill(q, colour, image, nearness):  # type: ignore[no-untyped-def]
    """Fill one convex quad (4, 3) of pixel x, y and nearness."""
    ax, ay, bx, by = q[2, 0] - q[0, 0], q[2, 1] - q[0, 1], q[3, 0] - q[1, 0], q[3, 1] - q[1, 1]
    turn = ax * by - ay * bx
    if abs(turn) < 1e-9:
        return
    way = 1.0 if turn > 0 else -1.0
    ux, uy, vx, vy = q[1, 0] - q[0, 0], q[1, 1] - q[0, 1], q[3, 0] - q[0, 0], q[3, 1] - q[0, 1]
    area = ux * vy - uy * vx
    if abs(area) < 1e-12:
        return
    un, vn = q[1, 2] - q[0, 2], q[3, 2] - q[0, 2]
    along_x, along_y = (un * vy - vn * uy) / area, (vn * ux - un * vx) / area
    left = max(0, int(np.ceil(min(q[0, 0], q[1, 0], q[2, 0], q[3, 0]) - 0.5)))
    right = min(image.shape[1] - 1, int(np.floor(max(q[0, 0], q[1, 0], q[2, 0], q[3, 0]) - 0.5)))
    top = max(0, int(np.ceil(min(q[0, 1], q[1, 1], q[2, 1], q[3, 1]) - 0.5)))
    bottom = min(image.shape[0] - 1, int(np.floor(max(q[0, 1], q[1, 1], q[2, 1], q[3, 1]) - 0.5)))
    for row in range(top, bottom + 1):
        y = row + 0.5
        for column in range(left, right + 1):
            x = column + 0.5
            near = q[0, 2] + along_x * (x - q[0, 0]) + along_y * (y - q[0, 1])
            if near <= nearness[row, column]:
                continue
            inside = True
            for c in range(4):
                d = (c + 1) & 3
                edge = (q[d, 0] - q[c, 0]) * (y - q[c, 1]) - (q[d, 1] - q[c, 1]) * (x - q[c, 0])
                if way * edge < 0.0:
                    inside = False
                    break
            if inside:
                nearness[row, column] = near
                image[row, column, 0] = np.uint8(min(255.0, colour[0] + 0.5))
                image[row, column, 1] = np.uint8(min(255.0, colour[1] + 0.5))
                image[row, column, 2] = np.uint8(min(255.0, colour[2] + 0.5))
