"""The point map: all sweeps of a run, stored as moments of the points in each voxel.

**Conventions.** Points are in the `map` frame. Sums are integers in units of `QUANTUM_M` (about a micrometre), so
adding sweeps in any order, any grouping and on any number of workers gives identical bits. Rows are sorted by key.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.geometry.lattice import Keys, centres_of, check_reach, pack, scatter
from stone.geometry.se3 import SE3
from stone.kernels.lanes import prefetch
from stone.sensors.calibration import Box
from stone.sensors.reach import FARTHEST_POINT_M

COUNT, FRAMES, OFFSET, VIEW = 0, 1, slice(2, 5), slice(5, 8)
LOAD_RATIO = 0.55
EVERYWHERE = Box((-FARTHEST_POINT_M,) * 3, (FARTHEST_POINT_M,) * 3)


@dataclass(frozen=True, eq=False)
class PointMap:
    """M voxels: `keys` (M,) sorted, `moments` (M, 8) int64 = points, frames, Σ offset from centre, Σ unit view."""

    voxel_m: float
    keys: Keys
    moments: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.keys)

    def counts(self) -> NDArray[np.int64]:
        """Return the number of points in each voxel (M,)."""
        return self.moments[:, COUNT]

    def frames_seen(self) -> NDArray[np.int64]:
        """Return the number of frames that hit each voxel (M,)."""
        return self.moments[:, FRAMES]

    def centroids_map(self) -> NDArray[np.float64]:
        """Return the mean point of each voxel (M, 3), metres."""
        return centres_of(self.keys, self.voxel_m) + self.moments[:, OFFSET] * QUANTUM_M / self.moments[:, :1]

    def views_map(self) -> NDArray[np.float64]:
        """Return the mean unit direction from each voxel to the sensors that saw it (M, 3), length ≤ 1."""
        return np.asarray(self.moments[:, VIEW] * QUANTUM_M / self.moments[:, :1])

    def where(self, keep: NDArray[np.bool_]) -> "PointMap":
        # five times faster than indexing with a mask
        return PointMap(self.voxel_m, np.compress(keep, self.keys), np.compress(keep, self.moments, axis=0))

    def where_seen(self, min_frames: int) -> "PointMap":
        """Return the voxels that were hit in at least `min_frames` frames."""
        return self.where(np.asarray(self.frames_seen() >= min_frames))


def merge(maps: Sequence[PointMap]) -> PointMap:
    """Return the map of all points of all maps, which contain disjoint frames. Exact, so the order does not matter."""
    keys = np.concatenate([part.keys for part in maps])
    moments = np.concatenate([part.moments for part in maps])
    order = np.argsort(keys, kind="stable")
    keys = keys[order]
    is_first = np.append(True, keys[1:] != keys[:-1])[: len(keys)]
    sums = np.zeros((int(is_first.sum()), moments.shape[1]), np.int64)
    _add_up(moments, order, is_first, sums)
    return PointMap(maps[0].voxel_m, keys[is_first], sums)


@njit(cache=True, nogil=True)
def _add_up(moments, order, is_first, sums):  # type: ignore[no-untyped-def]
    """Add the moments of each voxel, whose rows are consecutive in this order with the first one marked."""
    voxel = -1
    for at in range(order.size):
        voxel += is_first[at]
        for column in range(sums.shape[1]):
            sums[voxel, column] += moments[order[at], column]


class PointMapBuilder:
    """An incremental voxel hash: call `insert` for each sweep, then `finish`.

    The first table fits a minute of a full rig's map, so that it rarely grows; unused pages cost nothing.
    """

    def __init__(self, voxel_m: float, slots: int = 1 << 20) -> None:
        self._voxel_m = voxel_m
        self._rows = free_rows(slots)
        self._work = workspace()
        self._used = self._frames = self._points = 0
        self._full: list[PointMap] = []
        self.points = 0

    def insert(
        self,
        points_ego: NDArray[np.float32],
        map_from_ego: SE3,
        sensor_ego: NDArray[np.float64],
        reach: Box = EVERYWHERE,
    ) -> None:
        """Add one sweep (N, 3) seen from `sensor_ego` (3,): its points in the half-open box `reach` of the ego frame,
        nearer than `FARTHEST_POINT_M`.

        Raises `off_lattice` for a pose that is not finite or off the lattice.
        """
        sensor_map = map_from_ego @ sensor_ego
        check_reach(
            np.abs(sensor_map) + FARTHEST_POINT_M, self._voxel_m
        )  # a broken rotation shows in the sensor's position
        if self._frames >= MOST_FRAMES or self._points + len(points_ego) > MOST_POINTS:
            self._begin_another()
        box = np.array([reach.min_m, reach.max_m], np.float64)
        view = (box, map_from_ego.as_matrix(), sensor_map, self._voxel_m, self._frames)
        self._add(np.ascontiguousarray(points_ego, np.float32), view)
        self._frames += 1

    def _add(self, points_ego: NDArray[np.float32], view: tuple[object, ...]) -> None:
        state = np.array([0, self._used, 0, self._limit()], np.int64)
        while state[0] < len(points_ego):
            add_points(points_ego, view, self._rows, state, self._work)
            if state[0] < len(points_ego):
                self._grow()
                state[3] = self._limit()
        self._used, inside = int(state[1]), int(state[2])
        self._points += inside
        self.points += inside

    def _limit(self) -> int:
        return int(len(self._rows) * LOAD_RATIO)

    def _grow(self) -> None:
        larger = free_rows(2 * len(self._rows))
        move_rows(self._rows, larger)
        self._rows = larger

    def _begin_another(self) -> None:
        """Set the table's content aside, because its counters are nearly full."""
        self._full.append(self._finished())
        self._rows = free_rows(len(self._rows))
        self._used = self._frames = self._points = 0

    def _finished(self) -> PointMap:
        all_keys = np.ascontiguousarray(self._rows[:, 0])
        used = np.flatnonzero(all_keys != FREE)
        keys = all_keys[used]
        order = np.argsort(keys)
        moments = np.empty((len(used), 8), np.int64)
        unpack_rows(self._rows, used[order], moments)
        return PointMap(self._voxel_m, keys[order], moments)

    def finish(self) -> PointMap:
        """Return the inserted points as an immutable map."""
        return merge([*self._full, self._finished()]) if self._full else self._finished()


# The hot loops of the point map: they add a sweep's points to the rows of an open-addressing table. A row is one cache
# line of eight int64: the voxel's key, a counter, Σ offset from the centre and Σ unit view, in units of `QUANTUM_M`.
# Key 0 marks a free row; no voxel has it. The counter packs, lowest bit first: points (32 bits), frames (16), and 1 +
# the last counted frame (16). Points are processed in blocks: vectorised arithmetic first, then their rows are
# prefetched, and meanwhile the previous block is added to its rows.


QUANTUM_M = 2.0**-20
BLOCK = 256
ROW_BYTES, ROW_WORDS, AHEAD_ROWS = 64, 8, 24
FREE = 0
POINT_BITS, FRAME_BITS = 32, 16
# limits of the counter; the caller starts another table before
MOST_POINTS, MOST_FRAMES = 2**31, 2**16 - 1
LAST_AT = POINT_BITS + FRAME_BITS

Rows = NDArray[np.int64]


def free_rows(slots: int) -> Rows:
    """Return a table (slots, 8) of free rows, each in its own cache line; `slots` is a power of two."""
    raw = np.zeros(slots * 8 + 8, np.int64)
    first = (-raw.ctypes.data % ROW_BYTES) // 8
    return raw[first : first + slots * 8].reshape(slots, 8)


def workspace() -> tuple[Any, ...]:
    """Return buffers for one block (coordinates, inside flags) and for two alternating blocks (keys, slots, six sums
    per point).
    """
    return (
        (np.zeros((3, BLOCK), np.float32), np.zeros(BLOCK, np.int64)),
        (np.zeros((2, BLOCK), np.int64), np.zeros((2, BLOCK), np.int64), np.zeros((2, 6, BLOCK), np.int64)),
    )


@njit(cache=True, nogil=True)
def add_points(points, view, rows, state, work):  # type: ignore[no-untyped-def]
    """Add points (N, 3) from `state[0]` until all are added or the table could exceed `state[3]` rows.

    `view` is (box (2, 3), pose (4, 4), sensor (3,), voxel_m, frame); `state` counts points done, rows used, points
    inside the box, and contains the limit of rows.
    """
    box, pose, sensor, voxel_m, frame = view
    (xyz, inside), (keys, slots, sums) = work
    mark = np.int64(frame + 1) << LAST_AT
    waiting, turn = 0, 0  # points of the previous block, and the buffer it does not use
    while state[0] < points.shape[0] and state[1] + 2 * BLOCK <= state[3]:
        block = points[state[0] : state[0] + BLOCK]
        state[2] += _sift(block, box, xyz, inside)
        _prepare(xyz, inside, (pose, sensor, voxel_m), keys[turn], sums[turn])
        _locate(keys[turn], block.shape[0], rows, slots[turn])
        state[1] += _accumulate(keys[1 - turn, :waiting], slots[1 - turn], sums[1 - turn], rows, mark)
        waiting, turn = block.shape[0], 1 - turn
        state[0] += block.shape[0]
    state[1] += _accumulate(keys[1 - turn, :waiting], slots[1 - turn], sums[1 - turn], rows, mark)


@njit(cache=True, nogil=True)
def _sift(block, box, xyz, inside):  # type: ignore[no-untyped-def]
    """Split the coordinates; write 1 for each point inside the box, otherwise 0; return the number inside."""
    low0, low1, low2 = box[0]
    high0, high1, high2 = box[1]
    count = 0
    for p in range(block.shape[0]):
        x, y, z = block[p, 0], block[p, 1], block[p, 2]
        is_in = (low0 <= x) & (x < high0) & (low1 <= y) & (y < high1) & (low2 <= z) & (z < high2)
        xyz[0, p], xyz[1, p], xyz[2, p] = x, y, z
        inside[p] = is_in
        count += is_in
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def _prepare(xyz, inside, view, keys, sums):  # type: ignore[no-untyped-def]
    """Write key (`FREE` outside the box) and rounded sums of each point.

    Values are copied to local names before the loop, because the compiler cannot exclude that outputs overlap inputs.
    """
    pose, sensor, voxel_m = view
    m00, m01, m02, m03 = pose[0]
    m10, m11, m12, m13 = pose[1]
    m20, m21, m22, m23 = pose[2]
    s0, s1, s2 = sensor
    inverse, unit = 1.0 / voxel_m, 1.0 / QUANTUM_M
    for p in range(BLOCK):
        x, y, z = np.float64(xyz[0, p]), np.float64(xyz[1, p]), np.float64(xyz[2, p])
        mx = m00 * x + m01 * y + m02 * z + m03
        my = m10 * x + m11 * y + m12 * z + m13
        mz = m20 * x + m21 * y + m22 * z + m23
        i, j, k = np.floor(mx * inverse), np.floor(my * inverse), np.floor(mz * inverse)
        keys[p] = pack(int(i), int(j), int(k)) * inside[p]
        vx, vy, vz = s0 - mx, s1 - my, s2 - mz
        scale = unit / math.sqrt(vx * vx + vy * vy + vz * vz + 1e-12)
        sums[0, p] = np.int64(np.rint((mx - (i + 0.5) * voxel_m) * unit))
        sums[1, p] = np.int64(np.rint((my - (j + 0.5) * voxel_m) * unit))
        sums[2, p] = np.int64(np.rint((mz - (k + 0.5) * voxel_m) * unit))
        sums[3, p] = np.int64(np.rint(vx * scale))
        sums[4, p] = np.int64(np.rint(vy * scale))
        sums[5, p] = np.int64(np.rint(vz * scale))


@njit(cache=True, nogil=True)
def _locate(keys, count, rows, slots):  # type: ignore[no-untyped-def]
    """Write each key's first probe slot, and prefetch these rows in batches."""
    mask = np.uint64(rows.shape[0] - 1)
    for p in range(count):
        slots[p] = np.int64(scatter(keys[p]) & mask)
    for p in range(count):
        prefetch(rows, slots[p] * ROW_WORDS)


@njit(cache=True, nogil=True)
def _accumulate(keys, slots, sums, rows, mark):  # type: ignore[no-untyped-def]
    """Add the prepared points to their rows; return the number of rows that were free before."""
    claimed = 0
    for p in range(keys.shape[0]):
        key = keys[p]
        if key == FREE:
            continue
        slot = _slot_from(rows, slots[p], key)
        row = rows[slot]
        if row[0] == FREE:
            row[0] = key
            claimed += 1
        counter = row[1] + 1
        is_new_frame = np.int64((counter ^ mark) >> LAST_AT != 0)
        row[1] = (counter & ((1 << LAST_AT) - 1)) + (is_new_frame << POINT_BITS) | mark
        row[2] += sums[0, p]
        row[3] += sums[1, p]
        row[4] += sums[2, p]
        row[5] += sums[3, p]
        row[6] += sums[4, p]
        row[7] += sums[5, p]
    return claimed


@njit(inline="always")
def _slot_from(rows, slot, key):  # type: ignore[no-untyped-def]
    """Return the key's row, or the free row for it; probing starts at `slot`."""
    while rows[slot, 0] != key and rows[slot, 0] != FREE:
        slot = (slot + 1) & (rows.shape[0] - 1)
    return slot


@njit(cache=True, nogil=True)
def move_rows(old, new):  # type: ignore[no-untyped-def]
    """Copy every used row into a larger table."""
    mask = np.uint64(new.shape[0] - 1)
    for at in range(old.shape[0]):
        if old[at, 0] != FREE:
            new[_slot_from(new, np.int64(scatter(old[at, 0]) & mask), old[at, 0])] = old[at]


@njit(cache=True, nogil=True)
def unpack_rows(rows, order, moments):  # type: ignore[no-untyped-def]
    """Fill `moments` (M, 8): points, frames and the six sums of `rows[order]`."""
    for at in range(order.shape[0]):
        if at + AHEAD_ROWS < order.shape[0]:
            prefetch(rows, order[at + AHEAD_ROWS] * ROW_WORDS)
        row, out = rows[order[at]], moments[at]
        out[0] = row[1] & ((1 << POINT_BITS) - 1)
        out[1] = (row[1] >> POINT_BITS) & ((1 << FRAME_BITS) - 1)
        out[2], out[3], out[4], out[5], out[6], out[7] = row[2], row[3], row[4], row[5], row[6], row[7]
