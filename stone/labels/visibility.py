"""Visibility of the grid's voxels from one camera, including occlusion.

**Conventions.** Grids as in `stone_base.label_grid`. Sight is computed voxel by voxel outwards. The openness of the way
to a voxel is the openness at the point one step nearer to the camera. It is interpolated between the four voxels around
that point (XDraw: Franklin & Ray, 1994). A free voxel is seen if its way is at least half open. A labelled voxel is
also seen if a free voxel next to one of its camera-facing sides is, because the line ends there. At a grazing angle,
the way to its centre passes through other ground. A single neighbour instead of four would bend lines towards the
grid's axes. The steps depend only on the calibration, so they are computed once per robot; `stone.labels.sight_batches`
follows them for many frames at once.

The grid has a frame of one voxel on every side, which is open, for points nearer than its border.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.geometry.se3 import SE3
from stone.sensors.calibration import CameraIntrinsics
from stone_base.label_grid import PAPER, LabelGrid

OPEN = 240  # an unblocked way; 16 × 15 levels fit a byte
NEAR_M = 0.1
RIM = 2  # voxels: lines are followed this far outside the image, otherwise they would bypass walls there
FRAMED_HEIGHT = 34  # voxels, for grids of any height: columns are 32-bit words
VOXEL_BITS, SIDE_BIT = 22, 27
AT_SOURCE = 0  # the way of a voxel next to the camera, or of a source voxel that is out of sight itself
IN_IMAGE = np.uint32(1 << 31)


@dataclass(frozen=True, eq=False)
class SightLines:
    """Voxels in and around the image, each after all voxels before it on its line.

    `place` (S,) uint32: bits 0–21 are the voxel in the framed grid, flat. Bits 22–26 are the way to the four voxels
    around the point one step nearer, a row of `ways()`. Bits 27–29: its side on x, y, z faces the camera and the voxel
    before it is in view. Bit 31: it is in the image. `weight` (S, 4) uint8: the weights of the four voxels, with sum
    `OPEN`.
    """

    place: NDArray[np.uint32]
    weight: NDArray[np.uint8]


def framed(shape: tuple[int, ...]) -> tuple[int, int, int]:
    """Return the shape of a grid with its frame."""
    return shape[0] + 2, shape[1] + 2, FRAMED_HEIGHT


def ways(shape: tuple[int, ...]) -> NDArray[np.int64]:
    """Return (25, 6) flat steps in the framed grid by way. The steps lead to the first of the four, to the second, from
    the first to the third, and towards the camera along x, y and z.
    """
    table, size = np.zeros((25, 6), np.int64), framed(shape)
    strides = size[1] * size[2], size[2], 1
    for code in range(1, len(table)):
        main, step, below_one, below_other = _way_of(code)
        second, third = (main + 1) % 3, (main + 2) % 3
        first = strides[main] * step - strides[second] * below_one - strides[third] * below_other
        table[code, :3] = first, strides[second], strides[third]
        for axis, sign in ((main, step), (second, 1 - 2 * below_one), (third, 1 - 2 * below_other)):
            table[code, 3 + axis] = strides[axis] * sign
    return table


def _way_of(code: int) -> tuple[int, int, int, int]:
    """Return (axis, ±1, whether the point lies below the voxel on the next axis, and on the axis after it) of a way."""
    return (code - 1) >> 3, 1 if (code - 1) & 4 else -1, (code - 1) >> 1 & 1, (code - 1) & 1


def sight_lines(intrinsics: CameraIntrinsics, ego_from_camera: SE3, grid: LabelGrid = PAPER) -> SightLines:
    """Return the sight lines of one camera through the grid.

    The image border is the undistorted pinhole's. Within the grid's range, distortion bends lines inside the image by
    less than a voxel. Distortion models that fold back would include voxels behind the border.
    """
    k = intrinsics
    image = np.array([k.fx_px, k.fy_px, k.cx_px, k.cy_px, k.width_px, k.height_px], np.float64)
    low = np.array(grid.min_m)
    camera = (ego_from_camera.translation_m - low) / grid.voxel_m
    kinds = np.zeros(grid.shape, np.uint8)
    _project(ego_from_camera.inverse().as_matrix(), image, (low, grid.voxel_m), kinds)
    _add_sources(camera, kinds)
    ranks, layers = _ranks(camera, max(grid.shape))
    places = np.empty((np.count_nonzero(kinds), 3), np.int16)
    _sort(kinds, ranks, np.zeros(layers + 1, np.int64), places)
    lines = SightLines(np.empty(len(places), np.uint32), np.zeros((len(places), 4), np.uint8))
    _lay_out(places, camera, (kinds, framed(grid.shape)), (lines.place, lines.weight))
    return lines


def _ranks(camera: NDArray[np.float64], side: int) -> tuple[NDArray[np.int64], int]:
    """Return the rank (3, side) of each axis's voxel layers by distance from the camera, and the number of ranks."""
    middles = np.arange(side) + 0.5
    distances = np.abs(middles - camera[:, None])
    values, ranks = np.unique(distances, return_inverse=True)
    return ranks.reshape(distances.shape), len(values)


OUT_OF_SIGHT, SOURCE, AT_RIM, INSIDE = range(4)


@njit(cache=True, nogil=True)
def _project(camera_from_ego, image, layout, kinds):  # type: ignore[no-untyped-def]
    """Mark the voxels in the image, and the voxels nearer than `RIM` to it."""
    m, (low, voxel_m) = camera_from_ego, layout
    fx, fy, cx, cy, width, height = image
    for a in range(kinds.shape[0]):
        for b in range(kinds.shape[1]):
            for c in range(kinds.shape[2]):
                p = (low[0] + (a + 0.5) * voxel_m, low[1] + (b + 0.5) * voxel_m, low[2] + (c + 0.5) * voxel_m)
                z = m[2, 0] * p[0] + m[2, 1] * p[1] + m[2, 2] * p[2] + m[2, 3]
                if z <= NEAR_M:
                    continue
                u = fx * (m[0, 0] * p[0] + m[0, 1] * p[1] + m[0, 2] * p[2] + m[0, 3]) / z + cx
                v = fy * (m[1, 0] * p[0] + m[1, 1] * p[1] + m[1, 2] * p[2] + m[1, 3]) / z + cy
                rim_u, rim_v = RIM * voxel_m * fx / z, RIM * voxel_m * fy / z
                if 0 <= u < width and 0 <= v < height:
                    kinds[a, b, c] = INSIDE
                elif -rim_u <= u < width + rim_u and -rim_v <= v < height + rim_v:
                    kinds[a, b, c] = AT_RIM


@njit(inline="always")
def _nearer(at, camera):  # type: ignore[no-untyped-def]
    """Return (way, voxel, weights) of the four voxels around the point one step nearer to the camera.

    The voxel is the first of the four; the others follow on the axes after the main one.
    """
    x, y, z = camera[0] - (at[0] + 0.5), camera[1] - (at[1] + 0.5), camera[2] - (at[2] + 0.5)
    longest = max(abs(x), abs(y), abs(z))
    if longest <= 1.0:
        return AT_SOURCE, (at[0], at[1], at[2]), (OPEN, 0, 0, 0)
    main = 0 if abs(x) == longest else 1 if abs(y) == longest else 2
    p, q, r = (x, y, z) if main == 0 else (y, z, x) if main == 1 else (z, x, y)
    step = 1 if p > 0 else -1
    below_one, below_other = (1 if q < 0 else 0), (1 if r < 0 else 0)
    u, v = q / longest + below_one, r / longest + below_other  # from the first of the four, 0 to 1
    first = min(OPEN, round((1.0 - u) * (1.0 - v) * OPEN))
    second = min(OPEN - first, round(u * (1.0 - v) * OPEN))
    third = min(OPEN - first - second, round((1.0 - u) * v * OPEN))
    m, n, o = at[main] + step, at[(main + 1) % 3] - below_one, at[(main + 2) % 3] - below_other
    voxel = (m, n, o) if main == 0 else (o, m, n) if main == 1 else (n, o, m)
    way = 1 + main * 8 + (4 if step > 0 else 0) + below_one * 2 + below_other
    return way, voxel, (first, second, third, OPEN - first - second - third)


@njit(inline="always")
def _corner(voxel, way, corner):  # type: ignore[no-untyped-def]
    """Return the voxel of this corner of the four that start with `voxel`."""
    second, third = ((way - 1) // 8 + 1) % 3, ((way - 1) // 8 + 2) % 3
    du, dv = corner & 1, corner >> 1
    i = voxel[0] + (du if second == 0 else 0) + (dv if third == 0 else 0)
    j = voxel[1] + (du if second == 1 else 0) + (dv if third == 1 else 0)
    k = voxel[2] + (du if second == 2 else 0) + (dv if third == 2 else 0)
    return i, j, k


@njit(cache=True, nogil=True)
def _add_sources(camera, kinds):  # type: ignore[no-untyped-def]
    """Start lines from beyond the rim there: the source voxel blocks, voxels before it do not."""
    for a in range(kinds.shape[0]):
        for b in range(kinds.shape[1]):
            for c in range(kinds.shape[2]):
                if kinds[a, b, c] < AT_RIM:
                    continue
                way, voxel, weights = _nearer((a, b, c), camera)
                for corner in range(4 if way != AT_SOURCE else 0):
                    i, j, k = _corner(voxel, way, corner)
                    inside = 0 <= i < kinds.shape[0] and 0 <= j < kinds.shape[1] and 0 <= k < kinds.shape[2]
                    if inside and weights[corner] > 0 and kinds[i, j, k] == OUT_OF_SIGHT:
                        kinds[i, j, k] = SOURCE


@njit(cache=True, nogil=True)
def _sort(kinds, ranks, begins, places):  # type: ignore[no-untyped-def]
    """Sort by counting the greatest of the three distances, because a way leads to strictly nearer voxels."""
    for fill in range(2):
        for a in range(kinds.shape[0]):
            for b in range(kinds.shape[1]):
                flat = max(ranks[0, a], ranks[1, b])
                for c in range(kinds.shape[2]):
                    if kinds[a, b, c] == OUT_OF_SIGHT:
                        continue
                    rank = max(flat, ranks[2, c])
                    if fill:
                        at = begins[rank]
                        places[at, 0], places[at, 1], places[at, 2] = a, b, c
                        begins[rank] += 1
                    else:
                        begins[rank + 1] += 1
        if not fill:
            for rank in range(1, begins.size):
                begins[rank] += begins[rank - 1]


@njit(cache=True, nogil=True)
def _lay_out(places, camera, grid, out):  # type: ignore[no-untyped-def]
    (kinds, size), (voxels, weight) = grid, out
    for s in range(places.shape[0]):
        a, b, c = np.int64(places[s, 0]), np.int64(places[s, 1]), np.int64(places[s, 2])
        voxel = np.uint32(((a + 1) * size[1] + b + 1) * size[2] + c + 1)
        if kinds[a, b, c] == SOURCE:
            voxels[s] = voxel
            continue
        way, _, weights = _nearer((a, b, c), camera)
        voxels[s] = voxel | np.uint32(way << VOXEL_BITS) | (IN_IMAGE if kinds[a, b, c] == INSIDE else np.uint32(0))
        for axis in range(3):
            voxels[s] |= np.uint32(_shows(kinds, (a, b, c), camera, axis)) << np.uint32(SIDE_BIT + axis)
        for corner in range(4):
            weight[s, corner] = weights[corner]


@njit(inline="always")
def _shows(kinds, at, camera, axis):  # type: ignore[no-untyped-def]
    """Return whether a voxel's side on this axis faces the camera, and the voxel before that side is in view."""
    gap = camera[axis] - (at[axis] + 0.5)
    if abs(gap) <= 0.5:
        return False
    step = 1 if gap > 0 else -1
    i, j, k = at[0] + (step if axis == 0 else 0), at[1] + (step if axis == 1 else 0), at[2] + (step if axis == 2 else 0)
    inside = 0 <= i < kinds.shape[0] and 0 <= j < kinds.shape[1] and 0 <= k < kinds.shape[2]
    return inside and kinds[i, j, k] >= AT_RIM
