"""The label grid of one frame: cut from the labelled map, turned into the ego frame.

**Conventions.** The grid is ego-aligned: `GRID_MIN_M` to `GRID_MAX_M`, voxels of `VOXEL_M`, shape `GRID_SHAPE`, axes
x, y, z, C order. An ego voxel takes the class of the map voxel that holds its centre. Where the straight way between
two neighbouring centres crosses a labelled map voxel that neither centre hits, the nearer of the two takes its class:
so a surface closed in the map stays closed in the grid, whatever the yaw, pitch and roll.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.calibration import Box
from stone.lattice import Keys, indices_of
from stone.observed import BRICK, Observed
from stone.se3 import SE3
from stone.voxels import VOXEL_M

GRID_MIN_M = (-25.6, -25.6, -2.0)
GRID_MAX_M = (25.6, 25.6, 4.4)
GRID_SHAPE = (256, 256, 32)
GRID_BOX = Box(GRID_MIN_M, GRID_MAX_M)

CLASS_BITS, NEAR_BIT, OBSERVED_BIT = 0b0011, 0b0100, 0b1000
FRACTION_BITS = 20

Grid = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Window:
    """A dense block of the map: per voxel its class, whether a labelled voxel touches it, whether it was observed.

    `origin` (3,) int64 is the index of voxel [0, 0, 0]; `voxels` (X, Y, Z) uint8 holds the bits named above.
    """

    origin: NDArray[np.int64]
    voxels: Grid


def window_of(
    keys: Keys, classes: NDArray[np.uint8], observed: Observed, bounds: tuple[NDArray[np.int64], NDArray[np.int64]]
) -> Window:
    """The window of the half-open index range `bounds`; voxels outside it are left out."""
    low, high = bounds
    voxels = np.zeros(tuple(high - low), np.uint8)
    _put_classes(voxels, indices_of(keys) - low, classes)
    _put_observed(voxels, indices_of(observed.keys) * BRICK - low, observed.words)
    return Window(low, voxels)


@njit(cache=True, nogil=True)
def _put_classes(voxels, indices, classes):  # type: ignore[no-untyped-def]
    for p in range(indices.shape[0]):
        for di in range(-1, 2):
            for dj in range(-1, 2):
                for dk in range(-1, 2):
                    i, j, k = indices[p, 0] + di, indices[p, 1] + dj, indices[p, 2] + dk
                    if 0 <= i < voxels.shape[0] and 0 <= j < voxels.shape[1] and 0 <= k < voxels.shape[2]:
                        voxels[i, j, k] |= NEAR_BIT
                        if di == 0 and dj == 0 and dk == 0:
                            voxels[i, j, k] |= classes[p]


@njit(cache=True, nogil=True)
def _put_observed(voxels, corners, words):  # type: ignore[no-untyped-def]
    for b in range(corners.shape[0]):
        for bit in range(BRICK**3):
            if not (words[b] >> np.uint64(bit)) & np.uint64(1):
                continue
            i, j, k = corners[b, 0] + (bit >> 4), corners[b, 1] + ((bit >> 2) & 3), corners[b, 2] + (bit & 3)
            if 0 <= i < voxels.shape[0] and 0 <= j < voxels.shape[1] and 0 <= k < voxels.shape[2]:
                voxels[i, j, k] |= OBSERVED_BIT


def reconcile(classes: Grid, observed: Grid, visible: Grid) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Make the masks agree in place: what is labelled was observed, and cameras vouch for no voxel no ray reached.

    Returns the voxels by class (4,) and how many are in each mask (2,).
    """
    by_class, by_mask = np.zeros(4, np.int64), np.zeros(2, np.int64)
    _reconcile(classes.reshape(-1), observed.reshape(-1), visible.reshape(-1), (by_class, by_mask))
    return by_class, by_mask


@njit(cache=True, nogil=True)
def _reconcile(classes, observed, visible, counts):  # type: ignore[no-untyped-def]
    t = p = n = lidar = camera = 0
    for v in range(classes.size):
        seen = observed[v] | np.uint8(classes[v] != 0)
        observed[v] = seen
        visible[v] &= seen
        t += classes[v] == 1
        p += classes[v] == 2
        n += classes[v] == 3
        lidar += seen
        camera += visible[v]
    counts[0][0] = classes.size - t - p - n
    counts[0][1], counts[0][2], counts[0][3] = t, p, n
    counts[1][0], counts[1][1] = lidar, camera


def frame_bounds(map_from_ego: SE3, margin_voxels: int = 2) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The half-open range of map voxel indices that the grids at these poses (P,) can touch."""
    low, high = np.array(GRID_MIN_M), np.array(GRID_MAX_M)
    corners = np.array([[(low, high)[(c >> axis) & 1][axis] for axis in range(3)] for c in range(8)])
    corners_map = SE3(map_from_ego.wxyz_xyz[..., None, :]) @ corners
    indices = np.floor(corners_map.reshape(-1, 3) / VOXEL_M).astype(np.int64)
    return indices.min(axis=0) - margin_voxels, indices.max(axis=0) + margin_voxels + 1


def crop(window: Window, map_from_ego: SE3) -> tuple[Grid, Grid]:
    """(classes, observed 0/1), both of `GRID_SHAPE`, of the frame at this pose; outside the window all is 0."""
    classes, observed = np.zeros(GRID_SHAPE, np.uint8), np.zeros(GRID_SHAPE, np.uint8)
    scaled = map_from_ego.as_matrix() / VOXEL_M
    scaled[:3, 3] -= window.origin
    _crop(window.voxels, scaled, np.array(GRID_MIN_M), (classes, observed))
    return classes, observed


@njit(inline="always")
def _bits(voxels, i, j, k):  # type: ignore[no-untyped-def]
    if 0 <= i < voxels.shape[0] and 0 <= j < voxels.shape[1] and 0 <= k < voxels.shape[2]:
        return voxels[i, j, k]
    return np.uint8(0)


@njit(cache=True, nogil=True)
def _crop(voxels, scaled, low, out):  # type: ignore[no-untyped-def]
    """Positions are fixed-point map voxels (`FRACTION_BITS`): adding a step and shifting beats floor by far."""
    classes, observed = out
    one = np.float64(1 << FRACTION_BITS)
    step = np.empty((3, 3), np.int64)
    start = np.empty(3, np.int64)
    for r in range(3):
        for axis in range(3):
            step[r, axis] = round(scaled[r, axis] * VOXEL_M * one)
        first = scaled[r, 3]
        for axis in range(3):
            first += scaled[r, axis] * (low[axis] + 0.5 * VOXEL_M)
        start[r] = round(first * one)
    sx, sy, sz = voxels.shape
    flat = voxels.reshape(-1)
    count = classes.shape[2]
    cells = np.empty(count, np.uint8)
    su, sv, sw = step[0, 2], step[1, 2], step[2, 2]
    for a in range(classes.shape[0]):
        for b in range(classes.shape[1]):
            u = start[0] + a * step[0, 0] + b * step[0, 1]
            v = start[1] + a * step[1, 0] + b * step[1, 1]
            w = start[2] + a * step[2, 0] + b * step[2, 1]
            any_bits = _column(flat, (sx, sy, sz), (u, v, w, su, sv, sw), cells)
            if any_bits == 0:
                continue
            for c in range(count):
                observed[a, b, c] = cells[c] >> np.uint8(3)
            if any_bits & (CLASS_BITS | NEAR_BIT) == 0:
                continue
            for c in range(count):
                if cells[c] & CLASS_BITS:
                    classes[a, b, c] = cells[c] & CLASS_BITS
                elif cells[c] & NEAR_BIT:
                    _close(voxels, (u + c * su, v + c * sv, w + c * sw), step, classes, (a, b, c))


@njit(inline="always")
def _column(flat, shape, line, cells):  # type: ignore[no-untyped-def]
    """Fetch the map voxels along one upright line of ego centres; returns all their bits together."""
    u, v, w, su, sv, sw = line
    last = cells.size - 1
    inside = 0 <= u >> FRACTION_BITS < shape[0] and 0 <= (u + last * su) >> FRACTION_BITS < shape[0]
    inside &= 0 <= v >> FRACTION_BITS < shape[1] and 0 <= (v + last * sv) >> FRACTION_BITS < shape[1]
    inside &= 0 <= w >> FRACTION_BITS < shape[2] and 0 <= (w + last * sw) >> FRACTION_BITS < shape[2]
    any_bits = np.uint8(0)
    for c in range(cells.size):
        i, j, k = u >> FRACTION_BITS, v >> FRACTION_BITS, w >> FRACTION_BITS
        if inside or (0 <= i < shape[0] and 0 <= j < shape[1] and 0 <= k < shape[2]):
            cells[c] = flat[(i * shape[1] + j) * shape[2] + k]
        else:
            cells[c] = 0
        any_bits |= cells[c]
        u += su
        v += sv
        w += sw
    return any_bits


@njit(inline="always")
def _close(voxels, at, step, classes, index):  # type: ignore[no-untyped-def]
    """Look from a free centre back along each ego axis for a labelled voxel that the two centres step over."""
    i, j, k = at[0] >> FRACTION_BITS, at[1] >> FRACTION_BITS, at[2] >> FRACTION_BITS
    for axis in range(3):
        u, v, w = at[0] - step[0, axis], at[1] - step[1, axis], at[2] - step[2, axis]
        bi, bj, bk = u >> FRACTION_BITS, v >> FRACTION_BITS, w >> FRACTION_BITS
        moved = (bi != i) + (bj != j) + (bk != k)
        if moved < 2 or index[axis] == 0:
            continue
        corners = _bits(voxels, bi, j, k) | _bits(voxels, i, bj, k) | _bits(voxels, i, j, bk)
        if moved == 3:
            corners |= _bits(voxels, bi, bj, k) | _bits(voxels, bi, j, bk) | _bits(voxels, i, bj, bk)
        if not corners & CLASS_BITS or _bits(voxels, bi, bj, bk) & CLASS_BITS:
            continue
        _fill(voxels, ((u, v, w), at), (axis, index), classes)


@njit(cache=True, nogil=True)
def _fill(voxels, ends, place, classes):  # type: ignore[no-untyped-def]
    """Give the class stepped over between the two free centres to the nearer one."""
    axis, index = place
    cell, ratio = _stepped_over(voxels, ends[0], ends[1])
    if cell == 0:
        return
    if ratio >= 0.5:
        classes[index] = cell
    elif axis == 0:
        classes[index[0] - 1, index[1], index[2]] = cell
    elif axis == 1:
        classes[index[0], index[1] - 1, index[2]] = cell
    else:
        classes[index[0], index[1], index[2] - 1] = cell


@njit(cache=True, nogil=True)
def _stepped_over(voxels, a, b):  # type: ignore[no-untyped-def]
    """(class, where from a = 0 to b = 1) of the first labelled voxel between two cells; class 0: none."""
    i, j, k = a[0] >> FRACTION_BITS, a[1] >> FRACTION_BITS, a[2] >> FRACTION_BITS
    ei, ej, ek = b[0] >> FRACTION_BITS, b[1] >> FRACTION_BITS, b[2] >> FRACTION_BITS
    ti = ((max(i, ei) << FRACTION_BITS) - a[0]) / (b[0] - a[0]) if ei != i else 2.0
    tj = ((max(j, ej) << FRACTION_BITS) - a[1]) / (b[1] - a[1]) if ej != j else 2.0
    tk = ((max(k, ek) << FRACTION_BITS) - a[2]) / (b[2] - a[2]) if ek != k else 2.0
    while True:
        t = min(ti, tj, tk)
        if ti == t:
            i, ti = ei, 2.0
        elif tj == t:
            j, tj = ej, 2.0
        else:
            k, tk = ek, 2.0
        if i == ei and j == ej and k == ek:
            return np.uint8(0), 0.0
        bits = _bits(voxels, i, j, k) & CLASS_BITS
        if bits:
            return np.uint8(bits), t
