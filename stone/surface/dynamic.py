"""Moving objects: map voxels that later (or earlier) sweeps looked straight through.

**Conventions.** A map point is held against range images in the order of time. It is *missed* when all nine pixels
around it saw something clearly farther, and *hit* when its own pixel saw it. It moved when it was missed more than
`MISSES_PER_HIT` times as often as hit, and at least so many times as `fewest_misses` says. Of what came and went, which
is all misses before its first hit and after its last and none between, more misses than hits suffice.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.surface.neighbours import is_near
from stone.surface.range_image import DynamicParameters, RangeImage, arctangent, lens_of, spread

MISSES_PER_HIT = 2
FEWEST_MISSES, FEWEST_IF_RARE, FEWEST_OF_A_STAY = 2, 1, 3
RARE_S = 0.25  # from image to image: by the next one a vehicle is somewhere else
HITS, MISSES, MISSES_BEFORE, MISSES_SINCE = range(4)
FEW_FRAMES, FEW_HITS, TOUCH_M, TOUCHES = 6, 2, 0.2, 2

AT_ONCE = 1024  # points: what is computed of them stays in the cache


def vote(
    points_map: NDArray[np.float64], image: RangeImage, parameters: DynamicParameters, votes: NDArray[np.int32]
) -> None:
    """Add this image's verdict on the points (N, 3) to `votes` (N, 4) int32: hits, misses, misses before the first hit
    and since the last one. Images are to be given in the order of time."""
    p = parameters
    limits = (p.min_range_m**2, p.max_range_m**2, p.margin_m)
    around_m = spread(image.ranges_m, 1, 1)  # 0 where no ray went to any of the nine
    _vote(points_map, image.map_from_view.inverse().as_matrix(), (image.ranges_m, around_m, lens_of(p)), limits, votes)


def no_votes(points: int) -> NDArray[np.int32]:
    """Before the first image, (points, 4)."""
    return np.zeros((points, 4), np.int32)


def fewest_misses(image_period_s: float) -> int:
    """Without which nothing moved, for the time from one range image to the next."""
    return FEWEST_IF_RARE if image_period_s > RARE_S else FEWEST_MISSES


def is_moving(votes: NDArray[np.int32], fewest: int = FEWEST_MISSES) -> NDArray[np.bool_]:
    """Which points (N,) moved, by their votes (N, 4)."""
    hits, misses, before, since = votes.T
    came_and_went = (before > 0) & (since > 0) & (before + since == misses) & (misses > hits)
    is_often_missed = (misses >= fewest) & (misses > MISSES_PER_HIT * hits)
    return np.asarray(is_often_missed | (misses >= FEWEST_OF_A_STAY) & came_and_went)


def carried_along(
    points_map: NDArray[np.float64], frames_seen: NDArray[np.int64], votes: NDArray[np.int32], moving: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """`moving` (N,), and what was hardly ever seen and touches it: a walker's head before the sky, which no ray passes.

    Such a point was met in at most `FEW_FRAMES` frames and `FEW_HITS` votes, and lies within `TOUCH_M` of what moved,
    or of what touches it. Ground and walls beside a walker's way are seen often, so they stay.
    """
    moved = moving.copy()
    for _ in range(TOUCHES):
        doubtful = np.flatnonzero(~moved & (frames_seen <= FEW_FRAMES) & (votes[:, HITS] <= FEW_HITS))
        moved[doubtful[is_near(points_map[doubtful], points_map[moved], TOUCH_M)]] = True
    return moved


@njit(cache=True, nogil=True, error_model="numpy")
def _aim(block, m, lens, seen):  # type: ignore[no-untyped-def]
    """Squared range, row and column (3, B) of the points of a block (3, B); no branch, rows by axis: vectorised."""
    m00, m01, m02, m03 = m[0, 0], m[0, 1], m[0, 2], m[0, 3]
    m10, m11, m12, m13 = m[1, 0], m[1, 1], m[1, 2], m[1, 3]
    m20, m21, m22, m23 = m[2, 0], m[2, 1], m[2, 2], m[2, 3]
    top, per_row, per_column = lens
    squares, rows, columns = seen[0], seen[1], seen[2]
    px, py, pz = block[0], block[1], block[2]
    for p in range(px.size):
        x = m00 * px[p] + m01 * py[p] + m02 * pz[p] + m03
        y = m10 * px[p] + m11 * py[p] + m12 * pz[p] + m13
        z = m20 * px[p] + m21 * py[p] + m22 * pz[p] + m23
        across = x * x + y * y
        squares[p] = across + z * z
        rows[p] = (top - arctangent(z, math.sqrt(across))) / per_row
        columns[p] = (math.pi - arctangent(y, x)) / per_column


@njit(cache=True, nogil=True)
def _vote(points, m, image, limits, votes):  # type: ignore[no-untyped-def]
    ranges, around, lens = image
    rows, columns = ranges.shape
    block, seen = np.zeros((3, AT_ONCE)), np.empty((3, AT_ONCE))
    for begin in range(0, points.shape[0], AT_ONCE):
        count = min(AT_ONCE, points.shape[0] - begin)
        for at in range(count):
            for axis in range(3):
                block[axis, at] = points[begin + at, axis]
        _aim(block, m, lens, seen)
        for at in range(count):
            if not limits[0] <= seen[0, at] < limits[1] or not 1 <= seen[1, at] < rows - 1:
                continue
            r = math.sqrt(seen[0, at])
            row, column = math.floor(seen[1, at]), math.floor(seen[2, at]) % columns
            if around[row, column] > r + limits[2]:
                votes[begin + at, MISSES] += 1
                votes[begin + at, MISSES_SINCE] += 1
                if votes[begin + at, HITS] == 0:
                    votes[begin + at, MISSES_BEFORE] += 1
            elif abs(ranges[row, column] - r) < limits[2]:
                votes[begin + at, HITS] += 1
                votes[begin + at, MISSES_SINCE] = 0
