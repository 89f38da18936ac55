"""Observed voxels: every voxel that a LiDAR ray reached or passed.

**Conventions.** The set is kept as bricks of 4 × 4 × 4 voxels, one bit each in a uint64 word, so marking a voxel is
idempotent and sets from different sweeps join by OR: order and grouping do not matter. Bit (x·4 + y)·4 + z.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.geometry.lattice import EMPTY, Keys, check_reach, pack, scatter, slot_of
from stone.geometry.se3 import SE3
from stone.kernels.lanes import prefetch
from stone.labels.voxels import VOXEL_M

BRICK = 4
BLOCK = 256  # rays; a multiple of 8, so that a ray's place in its block says how it is thinned
LOAD_RATIO = 0.5
AHEAD = 16  # bricks: so many are asked for at once

# Along a ray time is counted in 2^-44 voxels, finer than doubles are added up along it; the lowest bits are a row.
TICKS = 2.0**44
ROW_BITS = 3
NEVER = 2.0**14  # voxels; further than any ray is followed


@dataclass(frozen=True)
class CarveParameters:
    """How rays are followed. Neighbouring rays pass through the same voxels near the sensor, so in a sweep of more than
    `sparse_rays` one ray in eight is followed from the sensor on, one more in eight from `thin_m` on, two more from
    twice and the other four from three times that range: at each there is still more than one ray per voxel."""

    max_range_m: float = 40.0
    thin_m: float = 8.0
    sparse_rays: int = 40_000
    every_frame: int = 5


@dataclass(frozen=True, eq=False)
class Observed:
    """`keys` (B,) sorted brick keys (lattice of `BRICK` voxels), `words` (B,) uint64 bits."""

    keys: Keys
    words: NDArray[np.uint64]


def union(parts: Sequence[Observed]) -> Observed:
    """What any of the parts observed."""
    keys = np.concatenate([part.keys for part in parts])
    words = np.concatenate([part.words for part in parts])
    order = np.argsort(keys, kind="stable")
    keys, words = keys[order], words[order]
    if len(keys) == 0:
        return Observed(keys, words)
    first = np.flatnonzero(np.concatenate([[True], keys[1:] != keys[:-1]]))
    return Observed(keys[first], np.bitwise_or.reduceat(words, first))


class Carver:
    """Follows the rays of sweep after sweep, then `finish`.

    A sweep is carved into a dense window of bricks around the sensor, whose bits are then joined to what is known: a
    step costs no look-up. The window is 9 MB at 40 m, and grows with the cube of the range.
    """

    def __init__(self, parameters: CarveParameters, slots: int = 1 << 16) -> None:
        self._parameters = parameters
        self._used = 0
        self._keys = np.full(slots, EMPTY, np.int64)
        self._words = np.zeros(slots, np.uint64)
        self._side = 2 * _window_radius(parameters) + 1
        self._window = np.zeros(self._side**3, np.uint64)
        self._touched = np.empty(self._side**3 + 1, np.int32)
        self._steps = _steps(self._side)
        self._rays = np.zeros((4, BLOCK))

    def carve(self, points_ego: NDArray[np.float32], map_from_ego: SE3, sensor_ego: NDArray[np.float64]) -> None:
        """Mark every voxel on the way from `sensor_ego` (3,) to each of the points (N, 3), both ends included.

        Raises `OffLatticeError` for a pose that is not finite or off the lattice.
        """
        p = self._parameters
        sensor = map_from_ego @ sensor_ego
        check_reach(np.abs(sensor) + p.max_range_m, VOXEL_M)
        thin_m = p.thin_m if len(points_ego) > p.sparse_rays else 0.0
        reach = (p.max_range_m / VOXEL_M, thin_m / VOXEL_M)
        origin = sensor / VOXEL_M
        corner = np.floor(origin).astype(np.int64) // BRICK - _window_radius(p)
        view = (map_from_ego.as_matrix(), origin, corner * BRICK)
        touched = _carve(points_ego, view, reach, (self._window, self._touched, self._steps, self._rays))
        while self._used + touched > int(len(self._keys) * LOAD_RATIO):
            self._grow()
        window = (self._window, self._touched[:touched], self._side)
        self._used += _join(window, corner, self._keys, self._words)

    def _grow(self) -> None:
        old = (self._keys, self._words)
        self._keys = np.full(2 * len(old[0]), EMPTY, np.int64)
        self._words = np.zeros(2 * len(old[0]), np.uint64)
        _rehash(old, (self._keys, self._words))

    def finish(self) -> Observed:
        used = np.flatnonzero(self._keys != EMPTY)
        order = used[np.argsort(self._keys[used])]
        return Observed(self._keys[order], self._words[order])


def _window_radius(parameters: CarveParameters) -> int:
    """How many bricks a ray may come away from that of the sensor, and one for rounding."""
    return math.ceil(parameters.max_range_m / (VOXEL_M * BRICK)) + 1


@njit(cache=True, nogil=True, error_model="numpy")
def _carve(points, view, reach, window):  # type: ignore[no-untyped-def]
    """Follow all rays through the window; how many of its bricks were touched."""
    words, touched, steps, rays = window
    count = 0
    for begin in range(0, points.shape[0], BLOCK):
        block = points[begin : begin + BLOCK]
        _aim(block, view[0], view[1], rays)
        for p in range(block.shape[0]):
            level = 0 if p % 8 == 0 else 1 if p % 8 == 4 else 2 if p % 4 == 2 else 3
            start, end = level * reach[1], min(rays[3, p], reach[0])
            if start < end and rays[3, p] <= NEVER:  # a length that is no number is none of a ray
                ray = rays[0, p], rays[1, p], rays[2, p], start, end
                count = _follow(ray, _begin(ray, view[1], view[2]), words, touched, steps, count)
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def _aim(block, pose, origin, rays):  # type: ignore[no-untyped-def]
    """Unit direction and length, in voxels, of the ray to each point."""
    m00, m01, m02, m03 = pose[0]
    m10, m11, m12, m13 = pose[1]
    m20, m21, m22, m23 = pose[2]
    o0, o1, o2 = origin
    for p in range(block.shape[0]):
        x, y, z = np.float64(block[p, 0]), np.float64(block[p, 1]), np.float64(block[p, 2])
        dx = (m00 * x + m01 * y + m02 * z + m03) / VOXEL_M - o0
        dy = (m10 * x + m11 * y + m12 * z + m13) / VOXEL_M - o1
        dz = (m20 * x + m21 * y + m22 * z + m23) / VOXEL_M - o2
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        rays[0, p], rays[1, p], rays[2, p], rays[3, p] = dx / length, dy / length, dz / length, length


@njit(inline="always")
def _begin(ray, origin, corner):  # type: ignore[no-untyped-def]
    """Where the ray enters the lattice: the voxel, counted from the window's corner, and how far in it."""
    dx, dy, dz, start, _end = ray
    x, y, z = origin[0] + dx * start, origin[1] + dy * start, origin[2] + dz * start
    i, j, k = math.floor(x), math.floor(y), math.floor(z)
    return i - corner[0], j - corner[1], k - corner[2], x - i, y - j, z - k


@njit(cache=True, nogil=True, error_model="numpy")
def _follow(ray, begin, words, touched, steps, count):  # type: ignore[no-untyped-def]
    """Amanatides & Woo (1987) through the voxel lattice; marks each voxel of the ray from its start to its end.

    Which axis is next is not foreseeable, so that a branch would be guessed wrong every other step. Crossings are whole
    numbers of `TICKS` that end in their row of `_steps`: the least of three is the next, and says where it leads.
    """
    tx, ax = _crossings(ray[0], begin[3], 0)
    ty, ay = _crossings(ray[1], begin[4], 2)
    tz, az = _crossings(ray[2], begin[5], 4)
    last = int((ray[4] - ray[3]) * TICKS) << ROW_BITS | (1 << ROW_BITS) - 1
    i, j, k = begin[0], begin[1], begin[2]
    side = steps[7, 0]
    brick = ((i >> 2) * side + (j >> 2)) * side + (k >> 2)
    place = np.uint64(brick * 64 + ((i & 3) * 4 + (j & 3)) * 4 + (k & 3))
    while True:
        at = place >> np.uint64(6)
        touched[count] = at
        count += words[at] == 0
        words[at] |= np.uint64(1) << (place & np.uint64(63))
        following = min(tx, min(ty, tz))
        if following > last:
            return count
        place += np.uint64(steps[following & ((1 << ROW_BITS) - 1), place & np.uint64(63)])
        tx += ax if tx == following else 0
        ty += ay if ty == following else 0
        tz += az if tz == following else 0


@njit(inline="always")
def _crossings(slope, offset, row):  # type: ignore[no-untyped-def]
    """When a ray that begins at `offset` in its voxel leaves it along this axis, and how long a voxel takes it."""
    is_up = slope > 0
    each = abs(1.0 / slope) if abs(slope) > 1e-12 else NEVER
    first = (1.0 - offset if is_up else offset) * each
    ticks = int(min(each, NEVER) * TICKS) << ROW_BITS
    return (int(min(first, NEVER) * TICKS) << ROW_BITS) + row + is_up, ticks


def _steps(side: int) -> NDArray[np.int64]:
    """What a step down (even rows) or up along x, y, z adds to each of 64 places in a brick: (8, 64), last `side`."""
    steps = np.zeros((1 << ROW_BITS, 64), np.int64)
    for axis, row in ((0, 0), (1, 2), (2, 4)):
        bit, brick = 4 ** (2 - axis), 64 * side ** (2 - axis)
        local = np.arange(64) // bit % BRICK
        steps[row] = np.where(local == 0, (BRICK - 1) * bit - brick, -bit)
        steps[row + 1] = np.where(local == BRICK - 1, brick - (BRICK - 1) * bit, bit)
    steps[-1] = side
    return steps


@njit(cache=True, nogil=True)
def _join(window, corner, keys, known):  # type: ignore[no-untyped-def]
    """Join the touched bricks to what is known and clear the window; how many of them are new."""
    words, touched, side = window
    new, mask, own = 0, np.uint64(keys.size - 1), np.empty(touched.size, np.int64)
    for n in range(touched.size):
        brick = np.int64(touched[n])
        i, j, k = brick // (side * side), brick // side % side, brick % side
        own[n] = pack(i + corner[0], j + corner[1], k + corner[2])
    for n in range(touched.size):
        if n + AHEAD < touched.size:
            first = np.int64(scatter(own[n + AHEAD]) & mask)
            prefetch(keys, first)
            prefetch(known, first)
            prefetch(words, np.int64(touched[n + AHEAD]))
        key, brick = own[n], touched[n]
        slot = slot_of(keys, key)
        new += keys[slot] == EMPTY
        keys[slot] = key
        known[slot] |= words[brick]
        words[brick] = 0
    return new


@njit(cache=True, nogil=True)
def _rehash(old, new):  # type: ignore[no-untyped-def]
    for row in range(old[0].size):
        if old[0][row] != EMPTY:
            slot = slot_of(new[0], old[0][row])
            new[0][slot] = old[0][row]
            new[1][slot] = old[1][row]
