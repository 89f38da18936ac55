"""The point map: all sweeps of a run, kept as the moments of what fell into each voxel.

**Conventions.** Points are in the `map` frame. Sums are integers in units of `QUANTUM_M` (about a micrometre), so
adding sweeps in any order, in any grouping, on any number of workers gives the same bits. Rows are sorted by key.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.lattice import EMPTY, Keys, centres_of, check_reach, pack, slot_of
from stone.se3 import SE3

QUANTUM_M = 2.0**-20
COUNT, FRAMES, OFFSET, VIEW = 0, 1, slice(2, 5), slice(5, 8)
LOAD_RATIO = 0.55
SWEEP_REACH_M = 1000.0


@dataclass(frozen=True, eq=False)
class PointMap:
    """M voxels: `keys` (M,) sorted, `moments` (M, 8) int64 = points, frames, Σ offset from centre, Σ unit view."""

    voxel_m: float
    keys: Keys
    moments: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.keys)

    def counts(self) -> NDArray[np.int64]:
        """Points that fell into each voxel (M,)."""
        return self.moments[:, COUNT]

    def frames_seen(self) -> NDArray[np.int64]:
        """Frames in which each voxel was hit (M,)."""
        return self.moments[:, FRAMES]

    def centroids_map(self) -> NDArray[np.float64]:
        """Mean point of each voxel (M, 3), metres."""
        return centres_of(self.keys, self.voxel_m) + self.moments[:, OFFSET] * QUANTUM_M / self.moments[:, :1]

    def views_map(self) -> NDArray[np.float64]:
        """Mean unit direction from each voxel to the sensors that saw it (M, 3), length ≤ 1."""
        return np.asarray(self.moments[:, VIEW] * QUANTUM_M / self.moments[:, :1])

    def where(self, keep: NDArray[np.bool_]) -> "PointMap":
        return PointMap(self.voxel_m, self.keys[keep], self.moments[keep])

    def where_seen(self, min_frames: int) -> "PointMap":
        """The voxels that were hit in at least so many frames."""
        return self.where(np.asarray(self.frames_seen() >= min_frames))


def merge(maps: Sequence[PointMap]) -> PointMap:
    """The map of all points of all maps; the maps hold disjoint frames. Exact, so the order does not matter."""
    keys = np.concatenate([part.keys for part in maps])
    moments = np.concatenate([part.moments for part in maps])
    order = np.argsort(keys, kind="stable")
    keys, moments = keys[order], moments[order]
    if len(keys) == 0:
        return PointMap(maps[0].voxel_m, keys, moments)
    first = np.flatnonzero(np.concatenate([[True], keys[1:] != keys[:-1]]))
    return PointMap(maps[0].voxel_m, keys[first], np.add.reduceat(moments, first, axis=0))


class PointMapBuilder:
    """An incremental voxel hash: `insert` sweep after sweep, then `finish`."""

    def __init__(self, voxel_m: float, slots: int = 1 << 18) -> None:
        self._voxel_m = voxel_m
        self._frame = 0
        self._used = 0
        self.points = 0
        self._allocate(slots)

    def _allocate(self, slots: int) -> None:
        self._keys = np.full(slots, EMPTY, np.int64)
        self._moments = np.zeros((slots, 8), np.int64)
        self._last_frame = np.full(slots, -1, np.int32)

    def insert(self, points_ego: NDArray[np.float32], map_from_ego: SE3, sensor_ego: NDArray[np.float64]) -> None:
        """Add one sweep (N, 3) seen from `sensor_ego` (3,), its points nearer than `SWEEP_REACH_M`.

        Raises `OffLatticeError` for a pose that is not finite or off the lattice.
        """
        sensor_map = map_from_ego @ sensor_ego
        check_reach(np.abs(sensor_map) + SWEEP_REACH_M, self._voxel_m)  # a broken rotation shows in the sensor's place
        matrix = map_from_ego.as_matrix()
        done = 0
        while done < len(points_ego):
            done, self._used = _insert(
                points_ego,
                done,
                (matrix, sensor_map, self._voxel_m, self._frame),
                (self._keys, self._moments, self._last_frame),
                self._used,
            )
            if done < len(points_ego):
                self._grow()
        self._frame += 1
        self.points += len(points_ego)

    def _grow(self) -> None:
        old = (self._keys, self._moments, self._last_frame)
        self._allocate(2 * len(self._keys))
        _rehash(old, (self._keys, self._moments, self._last_frame))

    def finish(self) -> PointMap:
        """What was inserted so far, as a frozen value."""
        used = np.flatnonzero(self._keys != EMPTY)
        order = used[np.argsort(self._keys[used])]
        return PointMap(self._voxel_m, self._keys[order], self._moments[order])


@njit(cache=True, nogil=True)
def _insert(points, begin, sweep, table, used):  # type: ignore[no-untyped-def]
    """Insert from `begin` until all points are in or the table is too full; (points done, slots used)."""
    pose, sensor, voxel_m, frame = sweep
    keys, moments, last_frame = table
    inverse, unit = 1.0 / voxel_m, 1.0 / QUANTUM_M
    limit = int(keys.size * LOAD_RATIO)
    last_key, row = np.int64(EMPTY), np.int64(0)
    for p in range(begin, points.shape[0]):
        x, y, z = np.float64(points[p, 0]), np.float64(points[p, 1]), np.float64(points[p, 2])
        mx = pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]
        my = pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]
        mz = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]
        i, j, k = math.floor(mx * inverse), math.floor(my * inverse), math.floor(mz * inverse)
        key = pack(i, j, k)
        if key != last_key:
            slot = slot_of(keys, key)
            if keys[slot] == EMPTY:
                if used >= limit:
                    return p, used
                keys[slot] = key
                used += 1
            last_key, row = key, slot
        vx, vy, vz = sensor[0] - mx, sensor[1] - my, sensor[2] - mz
        scale = unit / math.sqrt(vx * vx + vy * vy + vz * vz + 1e-12)
        moment = moments[row]
        moment[0] += 1
        moment[2] += round((mx - (i + 0.5) * voxel_m) * unit)
        moment[3] += round((my - (j + 0.5) * voxel_m) * unit)
        moment[4] += round((mz - (k + 0.5) * voxel_m) * unit)
        moment[5] += round(vx * scale)
        moment[6] += round(vy * scale)
        moment[7] += round(vz * scale)
        if last_frame[row] != frame:
            last_frame[row] = frame
            moment[1] += 1
    return points.shape[0], used


@njit(cache=True, nogil=True)
def _rehash(old, new):  # type: ignore[no-untyped-def]
    keys, moments, last_frame = new
    for row in range(old[0].size):
        key = old[0][row]
        if key == EMPTY:
            continue
        slot = slot_of(keys, key)
        keys[slot] = key
        moments[slot] = old[1][row]
        last_frame[slot] = old[2][row]
