"""Range images: the nearest return in each direction of a sweep, and the free range.

**Conventions.** An image contains, for each direction from the sensor in the ego frame, the nearest return (m).
Directions with rays but no return (sky) have the sweep's farthest range, because the sensor may not see farther;
directions without rays have 0. Rows go down from the highest elevation, columns clockwise from behind.
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.geometry.se3 import SE3

# A spinning LiDAR covers about 360° × 27°: this number of 0.4° pixels fits its rays.
FIELD_PX, RAYS_PER_PIXEL, MAX_SPREAD_PX = 60_000, 2.0, 3
# Few rings leave wide gaps at any ray count: sixteen over 40° leave 2.7°.
MAX_RING_GAP_PX = 7
MARGIN_PX = MAX_RING_GAP_PX - 1

AT_ONCE = 512  # points whose intermediate results stay in the cache

FEWEST_RAYS = math.ceil(RAYS_PER_PIXEL * FIELD_PX / (2 * MAX_SPREAD_PX + 1) ** 2)  # fewer rays leave holes


@dataclass(frozen=True)
class DynamicParameters:
    """Image geometry and reach of the vote; a pixel is about as wide as the gap between two rays."""

    every_frame: int = 2
    min_elevation_deg: float = -30.0
    max_elevation_deg: float = 22.0
    row_deg: float = 0.4
    column_deg: float = 0.4
    max_range_m: float = 40.0
    min_range_m: float = 1.0
    margin_m: float = 0.3

    @property
    def shape(self) -> tuple[int, int]:
        """The (rows, columns) of the image."""
        rows = math.ceil((self.max_elevation_deg - self.min_elevation_deg) / self.row_deg)
        return rows, round(360.0 / self.column_deg)


@dataclass(frozen=True, eq=False)
class RangeImage:
    """`ranges_m` (rows, columns) float32 seen from `map_from_view`: the sensor's position with the ego frame's axes."""

    map_from_view: SE3
    ranges_m: NDArray[np.float32]


def range_image(
    points_ego: NDArray[np.float32], map_from_ego: SE3, sensor_ego: NDArray[np.float64], parameters: DynamicParameters
) -> RangeImage:
    """Return the nearest return in each direction from `sensor_ego` (3,) of the points (N, 3), including the robot's
    own.

    Without the robot's own points, directions that its body hides would look like open sky.
    """
    rows, columns = parameters.shape
    nearest_m = np.full((rows + 2 * MARGIN_PX, columns), np.inf, np.float32)
    _project(points_ego, sensor_ego, lens_of(parameters), nearest_m.reshape(-1), (columns, *workspace()))
    sideways, between_rings = spread_px(len(points_ego)), ring_spread_px(nearest_m)
    nearest_m = spread(nearest_m, max(sideways, between_rings), sideways)[MARGIN_PX:-MARGIN_PX]
    ranges_m = np.where(np.isfinite(nearest_m), nearest_m, np.float32(0))
    if len(points_ego) >= FEWEST_RAYS:
        _open_up(ranges_m, ranges_m.max(initial=np.float32(0)))
    return RangeImage(view_of(map_from_ego, sensor_ego), ranges_m)


def view_of(map_from_ego: SE3, sensor_ego: NDArray[np.float64]) -> SE3:
    """Return `map_from_view`: the position of the sensor at `sensor_ego` (3,) with the ego frame's axes."""
    return SE3.from_parts(map_from_ego.wxyz, map_from_ego @ sensor_ego)


def spread_px(rays: int) -> int:
    """Return the number of pixels around its own that a return fills, so that a sparse sweep leaves no holes.

    The target is `RAYS_PER_PIXEL` in the filled square; the nearest return wins, so spreading only makes votes rarer.
    """
    width_px = math.sqrt(RAYS_PER_PIXEL * FIELD_PX / max(rays, 1))
    return min(MAX_SPREAD_PX, max(0, math.ceil((width_px - 1.0) / 2.0)))


def ring_spread_px(nearest_m: NDArray[np.float32]) -> int:
    """Return the number of rows up and down that returns (rows, columns; inf = none) must fill, from the median ring
    gap.

    It is the smallest number for which each pixel and its neighbours have a ray above and a ray below. A ray above hits
    the ground farther out; alone, it would vote the ground itself out. Gaps too wide to be ring gaps are not filled.
    """
    counts = _gap_counts(nearest_m, MAX_RING_GAP_PX + 1)
    median_px = int(np.argmax(2 * np.cumsum(counts) >= counts.sum()))
    return max(0, median_px - 1) if median_px <= MAX_RING_GAP_PX else 0


def spread(nearest_m: NDArray[np.float32], up_px: int, sideways_px: int) -> NDArray[np.float32]:
    """Return the minimum of the pixels (rows, columns) around each; columns form a ring, and rows end at the border."""
    wide, tall = np.empty_like(nearest_m), np.empty_like(nearest_m)
    _least_beside(nearest_m, sideways_px, wide)
    _least_above_and_below(wide, up_px, tall)
    return tall


def lens_of(p: DynamicParameters) -> tuple[float, float, float]:
    """Return (top elevation rad, rad per row, rad per column)."""
    return math.radians(p.max_elevation_deg), math.radians(p.row_deg), math.radians(p.column_deg)


def workspace() -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Return flat buffers for one block: three coordinates, the results of `aim`, and pixels."""
    return np.zeros(3 * AT_ONCE), np.zeros(3 * AT_ONCE), np.zeros(AT_ONCE, np.int64)


@njit(inline="always")
def arctangent(y, x):  # type: ignore[no-untyped-def]
    """Return atan2 to 3e-8 rad without a branch, for vector code (Abramowitz & Stegun, 1964, 4.4.49)."""
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


@njit(cache=True, nogil=True, error_model="numpy")
def aim(block, lens, seen):  # type: ignore[no-untyped-def]
    """Write squared range, row and column (not rounded) of a block's points; columns run clockwise from behind.

    Coordinates are `AT_ONCE` apart in one array, and so are the results: the compiler can then exclude overlaps and
    vectorise.
    """
    top, per_row, per_column = lens
    for p in range(AT_ONCE):
        x, y, z = block[p], block[AT_ONCE + p], block[2 * AT_ONCE + p]
        across = x * x + y * y
        seen[p] = across + z * z
        seen[AT_ONCE + p] = (top - arctangent(z, math.sqrt(across))) / per_row
        seen[2 * AT_ONCE + p] = (math.pi - arctangent(y, x)) / per_column


@njit(inline="always")
def pixel(row, column, columns):  # type: ignore[no-untyped-def]
    """Return the flat pixel of a row and a column from `aim`; a full turn wraps to the first column."""
    i, j = np.int64(math.floor(row)), np.int64(math.floor(column))
    return i * columns + (j if j < columns else j - columns)


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


@njit(cache=True, nogil=True, error_model="numpy")
def _project(points, sensor, lens, nearest, work):  # type: ignore[no-untyped-def]
    """Fill `nearest`, whose rows start `MARGIN_PX` above the field, because points just outside may spread into it."""
    columns, block, seen, at = work
    rows = nearest.size // columns
    for begin in range(0, points.shape[0], AT_ONCE):
        count = min(AT_ONCE, points.shape[0] - begin)
        for p in range(count):
            block[p] = points[begin + p, 0] - sensor[0]
            block[AT_ONCE + p] = points[begin + p, 1] - sensor[1]
            block[2 * AT_ONCE + p] = points[begin + p, 2] - sensor[2]
        aim(block, lens, seen)
        for p in range(AT_ONCE):
            row, r = seen[AT_ONCE + p], math.sqrt(seen[p])
            is_in = (row >= -MARGIN_PX) & (row < rows - MARGIN_PX) & (r >= 1e-3)
            column = seen[2 * AT_ONCE + p] if is_in else 0.0
            at[p] = pixel(row if is_in else 0.0, column, columns) + MARGIN_PX * columns
            seen[p] = r if is_in else np.inf
        for p in range(count):
            nearest[at[p]] = min(nearest[at[p]], seen[p])


@njit(cache=True, nogil=True)
def _open_up(ranges, farthest):  # type: ignore[no-untyped-def]
    """Replace 0 by the farthest range in directions with rays but no return.

    These are rows between the highest and the lowest return, in gaps of more rows than any two rings leave. Only
    columns with a return count, because a sensor may look to one side only.
    """
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
                ranges[begin:row, column] = farthest
            begin = row + 1


@njit(cache=True, nogil=True)
def _gap_counts(nearest, widest):  # type: ignore[no-untyped-def]
    """Count the returns by the number of rows below the next return above in their column; `widest` counts all larger
    gaps.
    """
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
