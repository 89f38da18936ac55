"""Which voxels were observed: every voxel that a LiDAR ray reached or passed.

**Conventions.** The set is kept as bricks of 4 × 4 × 4 voxels, one bit each in a uint64 word, so marking a voxel is
idempotent and sets from different sweeps join by OR: order and grouping do not matter. Bit (x·4 + y)·4 + z.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.lattice import EMPTY, Keys, indices_of, keys_from_indices, pack, slot_of
from stone.se3 import SE3
from stone.voxels import VOXEL_M

BRICK = 4
LOAD_RATIO = 0.5


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

    def voxel_keys(self) -> Keys:
        """The keys of all observed voxels on the `VOXEL_M` lattice."""
        bits = np.unpackbits(self.words.astype("<u8").view(np.uint8), bitorder="little").reshape(-1, 64)
        brick, bit = np.nonzero(bits)
        corner = np.stack([bit >> 4, (bit >> 2) & 3, bit & 3], axis=1)
        return keys_from_indices(indices_of(self.keys[brick]) * BRICK + corner)


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
    """Follows the rays of sweep after sweep, then `finish`."""

    def __init__(self, parameters: CarveParameters, slots: int = 1 << 16) -> None:
        self._parameters = parameters
        self._used = 0
        self._keys = np.full(slots, EMPTY, np.int64)
        self._words = np.zeros(slots, np.uint64)

    def carve(self, points_ego: NDArray[np.float32], map_from_ego: SE3, sensor_ego: NDArray[np.float64]) -> None:
        """Mark every voxel on the way from `sensor_ego` (3,) to each of the points (N, 3), both ends included."""
        p = self._parameters
        thin_m = p.thin_m if len(points_ego) > p.sparse_rays else 0.0
        reach = (p.max_range_m / VOXEL_M, thin_m / VOXEL_M)
        view = (map_from_ego.as_matrix(), (map_from_ego @ sensor_ego) / VOXEL_M)
        done = 0
        while done < len(points_ego):
            done, self._used = _carve(points_ego, done, view, reach, (self._keys, self._words), self._used)
            if done < len(points_ego):
                self._grow()

    def _grow(self) -> None:
        old = (self._keys, self._words)
        self._keys = np.full(2 * len(old[0]), EMPTY, np.int64)
        self._words = np.zeros(2 * len(old[0]), np.uint64)
        _rehash(old, (self._keys, self._words))

    def finish(self) -> Observed:
        used = np.flatnonzero(self._keys != EMPTY)
        order = used[np.argsort(self._keys[used])]
        return Observed(self._keys[order], self._words[order])


@njit(cache=True, nogil=True)
def _carve(points, begin, view, reach, table, used):  # type: ignore[no-untyped-def]
    """Follow rays from `begin` until all are done or the table is too full; (rays done, slots used)."""
    keys, words = table
    limit = int(keys.size * LOAD_RATIO) - 512  # one ray adds fewer bricks than this
    for p in range(begin, points.shape[0]):
        if used >= limit:
            return p, used
        level = 0 if p % 8 == 0 else 1 if p % 8 == 4 else 2 if p % 4 == 2 else 3
        used = _follow(points[p], view, (level * reach[1], reach[0]), keys, words, used)
    return points.shape[0], used


@njit(cache=True, nogil=True)
def _follow(point, view, span, keys, words, used):  # type: ignore[no-untyped-def]
    """Amanatides & Woo (1987) through the voxel lattice; marks each voxel of the ray from span[0] to its end."""
    m, origin = view
    x, y, z = np.float64(point[0]), np.float64(point[1]), np.float64(point[2])
    dx = (m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]) / VOXEL_M - origin[0]
    dy = (m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]) / VOXEL_M - origin[1]
    dz = (m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]) / VOXEL_M - origin[2]
    length = math.sqrt(dx * dx + dy * dy + dz * dz)
    end = min(length, span[1])
    if not span[0] < end:
        return used
    dx, dy, dz = dx / length, dy / length, dz / length
    ox, oy, oz = origin[0] + dx * span[0], origin[1] + dy * span[0], origin[2] + dz * span[0]
    i, j, k = math.floor(ox), math.floor(oy), math.floor(oz)
    si, sj, sk = (1 if dx > 0 else -1), (1 if dy > 0 else -1), (1 if dz > 0 else -1)
    ax = abs(1.0 / dx) if abs(dx) > 1e-12 else 1e18
    ay = abs(1.0 / dy) if abs(dy) > 1e-12 else 1e18
    az = abs(1.0 / dz) if abs(dz) > 1e-12 else 1e18
    tx = ((i + 1 - ox) if si > 0 else (ox - i)) * ax
    ty = ((j + 1 - oy) if sj > 0 else (oy - j)) * ay
    tz = ((k + 1 - oz) if sk > 0 else (oz - k)) * az
    end -= span[0]
    last, slot = np.int64(EMPTY), np.int64(0)
    while True:
        key = pack(i >> 2, j >> 2, k >> 2)
        if key != last:
            slot = slot_of(keys, key)
            if keys[slot] == EMPTY:
                keys[slot] = key
                used += 1
            last = key
        words[slot] |= np.uint64(1) << np.uint64(((i & 3) * 4 + (j & 3)) * 4 + (k & 3))
        if tx <= ty and tx <= tz:
            if tx > end:
                return used
            tx += ax
            i += si
        elif ty <= tz:
            if ty > end:
                return used
            ty += ay
            j += sj
        else:
            if tz > end:
                return used
            tz += az
            k += sk


@njit(cache=True, nogil=True)
def _rehash(old, new):  # type: ignore[no-untyped-def]
    for row in range(old[0].size):
        if old[0][row] != EMPTY:
            slot = slot_of(new[0], old[0][row])
            new[0][slot] = old[0][row]
            new[1][slot] = old[1][row]
