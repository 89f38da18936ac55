"""Moving objects: map voxels that later (or earlier) sweeps looked straight through.

**Conventions.** A range image holds, for each direction from the sensor in the ego frame, the nearest return (m),
`NOTHING_M` where rays went and none came back, as from the sky, and 0 where none went. A map point votes
*missed* when all nine pixels around it saw something clearly farther, and *hit* when its own pixel saw it. It moved
when it was missed `MISSES_PER_HIT` times as often as hit, and at least `FEWEST_MISSES` times.
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.geometry.se3 import SE3
from stone.surface.neighbours import is_near

MISSES_PER_HIT = 2
FEWEST_MISSES = 3
FEW_FRAMES, FEW_HITS, TOUCH_M, TOUCHES = 6, 2, 0.2, 2

# A spinning LiDAR covers about 360° × 27°: so many pixels of 0.4° hold its rays.
FIELD_PX, RAYS_PER_PIXEL, MAX_SPREAD_PX = 60_000, 2.0, 3
# Few rings leave wide gaps between them however many rays each has: sixteen over 40° leave 2.7°.
MAX_RING_GAP_PX = 7
MARGIN_PX = MAX_RING_GAP_PX - 1

NOTHING_M = np.float32(1e6)
FEWEST_RAYS = math.ceil(RAYS_PER_PIXEL * FIELD_PX / (2 * MAX_SPREAD_PX + 1) ** 2)  # fewer leave holes between them

AT_ONCE = 1024  # points: what is computed of them stays in the cache


@dataclass(frozen=True)
class DynamicParameters:
    """Image geometry and reach of the vote; a pixel is about as wide as the gap between two rays."""

    every_frame: int = 5
    min_elevation_deg: float = -30.0
    max_elevation_deg: float = 22.0
    row_deg: float = 0.4
    column_deg: float = 0.4
    max_range_m: float = 40.0
    min_range_m: float = 1.0
    margin_m: float = 0.3

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns) of the image."""
        rows = math.ceil((self.max_elevation_deg - self.min_elevation_deg) / self.row_deg)
        return rows, round(360.0 / self.column_deg)


@dataclass(frozen=True, eq=False)
class RangeImage:
    """`ranges_m` (rows, columns) float32 seen from `map_from_view`: the sensor's place, the ego's axes."""

    map_from_view: SE3
    ranges_m: NDArray[np.float32]


def range_image(
    points_ego: NDArray[np.float32], map_from_ego: SE3, sensor_ego: NDArray[np.float64], parameters: DynamicParameters
) -> RangeImage:
    """The nearest return in each direction from `sensor_ego` (3,) of the points (N, 3), the robot's own among them.

    Without those, what the robot's body hides would look like open sky.
    """
    rows, columns = parameters.shape
    nearest_m = np.full((rows + 2 * MARGIN_PX, columns), np.inf, np.float32)
    _project(points_ego, sensor_ego, _lens(parameters), nearest_m)
    sideways, between_rings = spread_px(len(points_ego)), ring_spread_px(nearest_m)
    nearest_m = _spread(nearest_m, max(sideways, between_rings), sideways)[MARGIN_PX:-MARGIN_PX]
    ranges_m = np.where(np.isfinite(nearest_m), nearest_m, np.float32(0))
    if len(points_ego) >= FEWEST_RAYS:
        _open_up(ranges_m)
    return RangeImage(view_of(map_from_ego, sensor_ego), ranges_m)


def view_of(map_from_ego: SE3, sensor_ego: NDArray[np.float64]) -> SE3:
    """`map_from_view`: the place of the sensor at `sensor_ego` (3,), the axes of the ego."""
    return SE3.from_parts(map_from_ego.wxyz, map_from_ego @ sensor_ego)


def spread_px(rays: int) -> int:
    """How many pixels around its own a return fills, so that a sparse sweep leaves no holes between its rays.

    Aims at `RAYS_PER_PIXEL` in the square it fills; the nearest return wins, so spreading only makes votes rarer.
    """
    width_px = math.sqrt(RAYS_PER_PIXEL * FIELD_PX / max(rays, 1))
    return min(MAX_SPREAD_PX, max(0, math.ceil((width_px - 1.0) / 2.0)))


def ring_spread_px(nearest_m: NDArray[np.float32]) -> int:
    """How many rows up and down returns (rows, columns; inf = none) must fill, given the median gap between rings.

    Just so many that each pixel and its neighbours hold a ray above and a ray below: where only the one above is seen,
    it strikes the ground farther out, and the ground itself is voted out. Gaps too wide to be between rings fill none.
    """
    counts = _gap_counts(nearest_m, MAX_RING_GAP_PX + 1)
    median_px = int(np.argmax(2 * np.cumsum(counts) >= counts.sum()))
    return max(0, median_px - 1) if median_px <= MAX_RING_GAP_PX else 0


def vote(
    points_map: NDArray[np.float64], image: RangeImage, parameters: DynamicParameters, votes: NDArray[np.int32]
) -> None:
    """Add this image's verdict on the points (N, 3) to `votes` (N, 2) int32: hits, misses."""
    p = parameters
    limits = (p.min_range_m**2, p.max_range_m**2, p.margin_m)
    around_m = _spread(image.ranges_m, 1, 1)  # 0 where no ray went to any of the nine
    _vote(points_map, image.map_from_view.inverse().as_matrix(), (image.ranges_m, around_m, _lens(p)), limits, votes)


def is_moving(votes: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Which points (N,) moved, by their votes (N, 2)."""
    hits, misses = votes[:, 0], votes[:, 1]
    return (misses > MISSES_PER_HIT * hits) & (misses >= FEWEST_MISSES)


def carried_along(
    points_map: NDArray[np.float64], frames_seen: NDArray[np.int64], votes: NDArray[np.int32], moving: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """`moving` (N,), and what was hardly ever seen and touches it: a walker's head before the sky, which no ray passes.

    Such a point was met in at most `FEW_FRAMES` frames and `FEW_HITS` votes, and lies within `TOUCH_M` of what moved,
    or of what touches it. Ground and walls beside a walker's way are seen often, so they stay.
    """
    moved = moving.copy()
    for _ in range(TOUCHES):
        doubtful = np.flatnonzero(~moved & (frames_seen <= FEW_FRAMES) & (votes[:, 0] <= FEW_HITS))
        moved[doubtful[is_near(points_map[doubtful], points_map[moved], TOUCH_M)]] = True
    return moved


def _spread(nearest_m: NDArray[np.float32], up_px: int, sideways_px: int) -> NDArray[np.float32]:
    """The least of the pixels (rows, columns) around each; columns close into a ring, beyond the rows is nothing."""
    wide, tall = np.empty_like(nearest_m), np.empty_like(nearest_m)
    _least_beside(nearest_m, sideways_px, wide)
    _least_above_and_below(wide, up_px, tall)
    return tall


def _lens(p: DynamicParameters) -> tuple[float, float, float]:
    """(top elevation rad, rad per row, rad per column)."""
    return math.radians(p.max_elevation_deg), math.radians(p.row_deg), math.radians(p.column_deg)


@njit(inline="always")
def _arctangent(y, x):  # type: ignore[no-untyped-def]
    """atan2 to 3e-8 rad, without a branch, so that many are computed at once (Abramowitz & Stegun, 1964, 4.4.49)."""
    u, v = abs(x), abs(y)
    t = min(u, v) / (max(u, v) + 1e-300)
    q = t * t
    s = 0.0028662257 * q - 0.0161657367
    s = s * q + 0.0429096138
    s = s * q - 0.0752896400
    s = s * q + 0.1065626393
    s = s * q - 0.1420889944
    s = s * q + 0.1999355085
    s = s * q - 0.3333314528
    a = t + t * q * s
    a = 0.5 * math.pi - a if v > u else a
    a = math.pi - a if x < 0 else a
    return math.copysign(a, y)


@njit(inline="always")
def _pixel(x, y, z, lens):  # type: ignore[no-untyped-def]
    """Row (may lie outside) and column of a direction; columns run clockwise from behind."""
    row = math.floor((lens[0] - _arctangent(z, math.sqrt(x * x + y * y))) / lens[1])
    column = math.floor((math.pi - _arctangent(y, x)) / lens[2])
    return row, column


@njit(cache=True, nogil=True)
def _least_beside(image, reach, out):  # type: ignore[no-untyped-def]
    rows, columns = image.shape
    for row in range(rows):
        for column in range(columns):
            out[row, column] = image[row, column]
        for shift in range(-reach, reach + 1):
            for column in range(max(0, -shift), min(columns, columns - shift)):
                out[row, column] = min(out[row, column], image[row, column + shift])
            for column in range(-shift):
                out[row, column] = min(out[row, column], image[row, column + shift + columns])
            for column in range(columns - shift, columns):
                out[row, column] = min(out[row, column], image[row, column + shift - columns])


@njit(cache=True, nogil=True)
def _least_above_and_below(image, reach, out):  # type: ignore[no-untyped-def]
    rows, columns = image.shape
    for row in range(rows):
        for column in range(columns):
            out[row, column] = image[row, column]
        for other in range(max(0, row - reach), min(rows, row + reach + 1)):
            for column in range(columns):
                out[row, column] = min(out[row, column], image[other, column])


@njit(cache=True, nogil=True)
def _project(points, sensor, lens, nearest):  # type: ignore[no-untyped-def]
    """Fill `nearest`, whose rows begin `MARGIN_PX` above the field: what lies just outside may spread into it."""
    for p in range(points.shape[0]):
        x, y, z = points[p, 0] - sensor[0], points[p, 1] - sensor[1], points[p, 2] - sensor[2]
        r = math.sqrt(x * x + y * y + z * z)
        if r < 1e-3:
            continue
        row, column = _pixel(x, y, z, lens)
        row, column = row + MARGIN_PX, column % nearest.shape[1]
        if 0 <= row < nearest.shape[0]:
            nearest[row, column] = min(nearest[row, column], r)


@njit(cache=True, nogil=True)
def _open_up(ranges):  # type: ignore[no-untyped-def]
    """Put `NOTHING_M` for 0 where rays went and none came back: in rows between the highest and the lowest return, in
    columns that have one (a sensor that looks to one side knows nothing of the other), and where more rows are empty
    than any two rings leave between them."""
    rows, columns = ranges.shape
    top, bottom = rows, 0
    for row in range(rows):
        if ranges[row].any():
            top, bottom = min(top, row), row + 1
    for column in range(columns):
        if not ranges[top:bottom, column].any():
            continue
        begin = top
        for row in range(top, bottom + 1):
            if row < bottom and ranges[row, column] == 0:
                continue
            if row - begin > MAX_RING_GAP_PX:
                ranges[begin:row, column] = NOTHING_M
            begin = row + 1


@njit(cache=True, nogil=True)
def _gap_counts(nearest, widest):  # type: ignore[no-untyped-def]
    """How many returns lie so many rows below the next above them in their column; `widest` counts all from there."""
    counts = np.zeros(widest + 1, np.int64)
    above = np.full(nearest.shape[1], -1, np.int64)
    for row in range(nearest.shape[0]):
        for column in range(nearest.shape[1]):
            if nearest[row, column] == np.inf:
                continue
            if above[column] >= 0:
                counts[min(row - above[column], widest)] += 1
            above[column] = row
    return counts


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
        rows[p] = (top - _arctangent(z, math.sqrt(across))) / per_row
        columns[p] = (math.pi - _arctangent(y, x)) / per_column


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
                votes[begin + at, 1] += 1
            elif abs(ranges[row, column] - r) < limits[2]:
                votes[begin + at, 0] += 1
