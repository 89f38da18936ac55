"""The point map: all sweeps of a run, kept as the moments of what fell into each voxel.

**Conventions.** Points are in the `map` frame. Sums are integers in units of `QUANTUM_M` (about a micrometre), so
adding sweeps in any order, in any grouping, on any number of workers gives the same bits. Rows are sorted by key.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.geometry.lattice import Keys, centres_of, check_reach
from stone.geometry.se3 import SE3
from stone.sensors.calibration import Box
from stone.sensors.reach import FARTHEST_POINT_M
from stone.surface.moments import (
    FREE,
    MOST_FRAMES,
    MOST_POINTS,
    QUANTUM_M,
    add_points,
    free_rows,
    move_rows,
    unpack_rows,
    workspace,
)

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
        # with a mask as an index it takes five times as long
        return PointMap(self.voxel_m, np.compress(keep, self.keys), np.compress(keep, self.moments, axis=0))

    def where_seen(self, min_frames: int) -> "PointMap":
        """The voxels that were hit in at least so many frames."""
        return self.where(np.asarray(self.frames_seen() >= min_frames))


def merge(maps: Sequence[PointMap]) -> PointMap:
    """The map of all points of all maps; the maps hold disjoint frames. Exact, so the order does not matter."""
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
    """Add the moments of each voxel, whose rows follow each other in this order, the first of each being marked."""
    voxel = -1
    for at in range(order.size):
        voxel += is_first[at]
        for column in range(sums.shape[1]):
            sums[voxel, column] += moments[order[at], column]


class PointMapBuilder:
    """An incremental voxel hash: `insert` sweep after sweep, then `finish`.

    The first table is made for a minute of a full rig's map, so that it rarely has to grow; its pages cost nothing
    until they are used.
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

        Raises `OffLatticeError` for a pose that is not finite or off the lattice.
        """
        sensor_map = map_from_ego @ sensor_ego
        check_reach(
            np.abs(sensor_map) + FARTHEST_POINT_M, self._voxel_m
        )  # a broken rotation shows in the sensor's place
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
        """The table's counters are nearly full: what it holds is set aside."""
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
        """What was inserted so far, as a frozen value."""
        return merge([*self._full, self._finished()]) if self._full else self._finished()
