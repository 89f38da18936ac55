"""Moving objects: map voxels that later (or earlier) sweeps looked straight through.

**Conventions.** A map point is compared with range images in time order. It is *missed* if all nine pixels around it
saw something clearly farther, and *hit* if its own pixel saw it. It moved if it was missed more than `MISSES_PER_HIT`
times as often as hit, and at least `fewest_misses` times. For temporary objects (all misses before the first hit or
after the last), more misses than hits suffice.
"""

import math
from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.geometry.lattice import keys_of
from stone.geometry.se3 import SE3
from stone.surface.neighbours import is_near
from stone.surface.range_image import (
    AT_ONCE,
    DynamicParameters,
    RangeImage,
    aim,
    lens_of,
    pixel,
    workspace,
)

MISSES_PER_HIT = 2
FEWEST_MISSES, FEWEST_IF_RARE, FEWEST_OF_A_STAY = 2, 1, 3
RARE_S = 0.25  # from image to image: by the next image, a vehicle has moved on
HITS, MISSES, MISSES_BEFORE, MISSES_SINCE = range(4)
FEW_FRAMES, FEW_HITS, TOUCH_M, TOUCHES = 6, 2, 0.2, 2

PLACE_M = 4.0  # points of one cube are processed together, so that cubes out of reach are skipped
SLACK_M = 0.01  # more than the rounding of any distance


class MotionVotes:
    """The votes of range images, in time order, on points (N, 3); `counts` are the votes so far.

    Points are stored in blocks of `AT_ONCE` neighbouring points: axis by axis, for vector code, and with their bounding
    box, so that blocks out of an image's reach are skipped.
    """

    def __init__(self, points_map: NDArray[np.float64], parameters: DynamicParameters) -> None:
        self._parameters = parameters
        self._order = np.argsort(keys_of(points_map, PLACE_M), kind="stable")
        padded = np.append(self._order, np.repeat(self._order[-1:], -len(self._order) % AT_ONCE))  # complete blocks
        by_block = np.ascontiguousarray(points_map[padded].reshape(-1, AT_ONCE, 3).transpose(0, 2, 1))
        self._boxes = by_block.min(axis=2), by_block.max(axis=2)
        self._is_near = np.zeros(len(by_block), np.bool_)
        self._points = by_block.reshape(-1)
        self._votes = np.zeros(len(by_block) * 4 * AT_ONCE, np.int32)
        self._work = workspace()

    def add(self, images: Sequence[RangeImage]) -> None:
        """Add the votes of these images, at least one, on every point."""
        p = self._parameters
        views = SE3(np.stack([image.map_from_view.wxyz_xyz for image in images]))
        matrices, limits = views.inverse().as_matrix(), (p.min_range_m**2, p.max_range_m**2, p.margin_m)
        pixels = np.empty(2 * images[0].ranges_m.size, np.float32)
        for image, matrix, position in zip(images, matrices, views.translation_m, strict=True):
            if not _mark_near(self._boxes, position, (p.max_range_m + SLACK_M) ** 2, self._is_near):
                continue
            _pair_up(image.ranges_m, pixels)
            view = (matrix, pixels, image.ranges_m.shape, lens_of(p))
            _vote(self._points, self._is_near, view, limits, (self._votes, *self._work))

    def counts(self) -> NDArray[np.int32]:
        """Return (N, 4): hits, misses, misses before the first hit and since the last one."""
        by_point = self._votes.reshape(-1, 4, AT_ONCE).transpose(0, 2, 1).reshape(-1, 4)
        counts = np.empty((len(self._order), 4), np.int32)
        counts[self._order] = by_point[: len(self._order)]
        return counts


def fewest_misses(image_period_s: float) -> int:
    """Return the minimum number of misses of a moving point, for the time between range images."""
    return FEWEST_IF_RARE if image_period_s > RARE_S else FEWEST_MISSES


def is_moving(votes: NDArray[np.int32], fewest: int = FEWEST_MISSES) -> NDArray[np.bool_]:
    """Return which points (N,) moved, from their votes (N, 4)."""
    hits, misses, before, since = votes.T
    came_and_went = (before > 0) & (since > 0) & (before + since == misses) & (misses > hits)
    is_often_missed = (misses >= fewest) & (misses > MISSES_PER_HIT * hits)
    return np.asarray(is_often_missed | (misses >= FEWEST_OF_A_STAY) & came_and_went)


def carried_along(
    points_map: NDArray[np.float64], frames_seen: NDArray[np.int64], votes: NDArray[np.int32], moving: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Return `moving` (N,) plus rarely seen points that touch it, such as a walker's head before the sky, which no ray
    passes.

    Such a point was hit in at most `FEW_FRAMES` frames and `FEW_HITS` votes, and lies within `TOUCH_M` of a moving
    point, or of a point that touches one. Ground and walls beside a walker's path are seen often, so they stay.
    """
    moved = moving.copy()
    for _ in range(TOUCHES):
        doubtful = np.flatnonzero(~moved & (frames_seen <= FEW_FRAMES) & (votes[:, HITS] <= FEW_HITS))
        moved[doubtful[is_near(points_map[doubtful], points_map[moved], TOUCH_M)]] = True
    return moved


@njit(cache=True, nogil=True)
def _mark_near(boxes, position, reach_squared, near):  # type: ignore[no-untyped-def]
    """Mark the blocks with a box within reach of a position (3,); return whether there is any."""
    (low, high), is_any_near = boxes, False
    for b in range(near.size):
        square = 0.0
        for axis in range(3):
            gap = max(0.0, low[b, axis] - position[axis], position[axis] - high[b, axis])
            square += gap * gap
        near[b] = square < reach_squared
        is_any_near |= near[b]
    return is_any_near


@njit(cache=True, nogil=True)
def _pair_up(ranges, pixels):  # type: ignore[no-untyped-def]
    """Write the range of every pixel, and the minimum of the nine around it; 0 without a ray in any of them."""
    rows, columns = ranges.shape
    least = np.empty(columns + 2, np.float32)
    for row in range(rows):
        here, above, below = ranges[row], ranges[max(row - 1, 0)], ranges[min(row + 1, rows - 1)]
        for column in range(columns):
            least[column + 1] = min(here[column], min(above[column], below[column]))
        least[0], least[columns + 1] = least[columns], least[1]  # the columns form a ring
        out = pixels[2 * row * columns : 2 * (row + 1) * columns]
        for column in range(columns):
            out[2 * column] = here[column]
            out[2 * column + 1] = min(least[column + 1], min(least[column], least[column + 2]))


@njit(cache=True, nogil=True, error_model="numpy")
def _vote(points, near, view, limits, out):  # type: ignore[no-untyped-def]
    """Vote on the near blocks one by one: transform, aim, look up, judge. Arrays are flat, like those of `aim`."""
    m, pixels, shape, lens = view
    votes, block, seen, at = out
    for b in range(near.size):
        if not near[b]:
            continue
        _turn(points[b * 3 * AT_ONCE : (b + 1) * 3 * AT_ONCE], m, block)
        aim(block, lens, seen)
        _find_pixels(seen, shape, limits, at)
        _look_up(pixels, at, seen)
        _judge(seen, limits[2], votes[b * 4 * AT_ONCE : (b + 1) * 4 * AT_ONCE])


@njit(cache=True, nogil=True)
def _turn(points, m, block):  # type: ignore[no-untyped-def]
    """Transform the points of a block to the view."""
    m00, m01, m02, m03 = m[0, 0], m[0, 1], m[0, 2], m[0, 3]
    m10, m11, m12, m13 = m[1, 0], m[1, 1], m[1, 2], m[1, 3]
    m20, m21, m22, m23 = m[2, 0], m[2, 1], m[2, 2], m[2, 3]
    for p in range(AT_ONCE):
        x, y, z = points[p], points[AT_ONCE + p], points[2 * AT_ONCE + p]
        block[p] = m00 * x + m01 * y + m02 * z + m03
        block[AT_ONCE + p] = m10 * x + m11 * y + m12 * z + m13
        block[2 * AT_ONCE + p] = m20 * x + m21 * y + m22 * z + m23


@njit(cache=True, nogil=True, error_model="numpy")
def _find_pixels(seen, shape, limits, at):  # type: ignore[no-untyped-def]
    """Write the pixel of every point of a block, and its range instead of the square; NaN if it is not judged."""
    rows, columns = shape
    for p in range(AT_ONCE):
        square, row, column = seen[p], seen[AT_ONCE + p], seen[2 * AT_ONCE + p]
        is_judged = (limits[0] <= square) & (square < limits[1]) & (row >= 1) & (row < rows - 1)
        at[p] = pixel(row if is_judged else 0.0, column if is_judged else 0.0, columns)
        seen[p] = math.sqrt(square) if is_judged else np.nan


@njit(cache=True, nogil=True)
def _look_up(pixels, at, seen):  # type: ignore[no-untyped-def]
    """Write the range in each point's pixel, and the minimum around it."""
    for p in range(AT_ONCE):
        seen[AT_ONCE + p], seen[2 * AT_ONCE + p] = pixels[2 * at[p]], pixels[2 * at[p] + 1]


@njit(cache=True, nogil=True)
def _judge(seen, margin, votes):  # type: ignore[no-untyped-def]
    for p in range(AT_ONCE):
        r, there, around = seen[p], seen[AT_ONCE + p], seen[2 * AT_ONCE + p]
        is_miss = around > r + margin
        is_hit = (not is_miss) & (abs(there - r) < margin)
        hits, misses = votes[p], votes[AT_ONCE + p]
        before, since = votes[2 * AT_ONCE + p], votes[3 * AT_ONCE + p]
        votes[p], votes[AT_ONCE + p] = hits + is_hit, misses + is_miss
        votes[2 * AT_ONCE + p] = before + (is_miss & (hits == 0))
        votes[3 * AT_ONCE + p] = 0 if is_hit else since + is_miss
