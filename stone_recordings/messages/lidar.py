"""Points, times and rings out of a LiDAR cloud, whatever its driver calls them.

**Conventions.** Points without a return are NaN, infinite or (0, 0, 0) and are dropped, and so are those out of reach
(`stone.sensors.reach`), which are counted. Times are read by `stone_recordings.messages.point_times`; a point of a
timed sweep that has none is dropped. Source: Hesai ROS 2.0, Nebula, Velodyne and Ouster drivers.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.sensors.reach import is_in_reach
from stone_recordings.bags.errors import CloudLayoutError
from stone_recordings.messages.point_times import UNTIMED, PointClock, point_times

RING_NAMES = ("ring", "channel", "laser_id", "line")
LAST_RING = 1023


@dataclass(frozen=True, eq=False)
class LidarPoints:
    """N returns: (N, 3) float32 metres in the LiDAR frame, and where the cloud says so when and by which laser.

    `offset_ns` is relative to the header stamp; `time_meaning` says how it was read ("absolute s", "relative ns",
    "none", "another clock", "too coarse"); `rows` (N,) are the records of the cloud that the returns are, and `beyond`
    counts those that are places out of any LiDAR's reach. Of the times `wrapped`, `filled` and `untimed` (dropped) are
    those of `PointTimes`.
    """

    points_lidar: NDArray[np.float32]
    offset_ns: NDArray[np.int64] | None
    ring: NDArray[np.uint16] | None
    time_meaning: str
    rows: NDArray[np.int32]
    beyond: int
    wrapped: int = 0
    filled: int = 0
    untimed: int = 0

    @property
    def mistimed(self) -> int:
        """How many points had no time of the sweep as they were written."""
        return self.wrapped + self.filled + self.untimed


def resolve_points(
    points: NDArray[np.void], stamp_ns: int, *, with_ring: bool = True, clock: PointClock | None = None
) -> LidarPoints:
    """Return the returns of a cloud; `clock` is known of its points if it is not the header's.

    Raises: CloudLayoutError when there are no x, y, z of one floating type.
    """
    check_xyz(points.dtype)
    xyz, kept, beyond = _packed(points)
    times = point_times(points, kept, stamp_ns, clock)
    offset_ns = times.offset_ns
    if offset_ns is not None and times.untimed:
        is_timed = offset_ns != UNTIMED
        xyz, kept, offset_ns = xyz[is_timed], kept[is_timed], offset_ns[is_timed]
    ring, counts = _rings(points, kept) if with_ring else None, (times.wrapped, times.filled, times.untimed)
    return LidarPoints(xyz, offset_ns, ring, times.meaning, kept, beyond, *counts)


def check_xyz(record: np.dtype[np.void]) -> None:
    """Raises: CloudLayoutError when a point has no x, y, z of one floating type."""
    names = record.names or ()
    codes = {record[name].str for name in "xyz" if name in names}
    if not set("xyz") <= set(names) or codes not in ({"<f4"}, {"<f8"}):
        raise CloudLayoutError(f"x, y and z must be floats of one size, its fields are {', '.join(names)}"[:200])


def _packed(points: NDArray[np.void]) -> tuple[NDArray[np.float32], NDArray[np.int32], int]:
    """The returns, their rows, and how many places out of reach were left out."""
    xyz = np.empty((len(points), 3), np.float32)
    kept = np.empty(len(points), np.int32)
    count, beyond = pack_points((points["x"], points["y"], points["z"]), xyz, kept)
    return xyz[:count], kept[:count], beyond


def _rings(points: NDArray[np.void], kept: NDArray[np.int32]) -> NDArray[np.uint16] | None:
    """The first nominated field that holds small whole numbers."""
    for name in RING_NAMES:
        if name not in (points.dtype.names or ()) or points.dtype[name].kind not in "fiu":
            continue
        values = np.empty(len(kept), np.uint16)
        if small_wholes(points[name], kept, LAST_RING, values):
            return values
    return None


# The hot loops of reading a cloud: unaligned columns of its records in, packed returns out.
#
# **Conventions.** Columns are fields of a structured view, unaligned and strided; nothing of them is copied before it
# is known to be a return. No fastmath: NaN and −0 must be told apart from numbers as IEEE 754 does.


@njit(cache=True, nogil=True)
def pack_points(
    xyz: tuple[NDArray[Any], NDArray[Any], NDArray[Any]], points: NDArray[np.float32], kept: NDArray[np.int32]
) -> tuple[int, int]:
    """Fill `points` (N, 3) with every non-zero point in reach and `kept` (N,) with its row.

    Gives how many these are, and how many are numbers but out of reach; NaN and ±inf say that there was no return.
    """
    count = beyond = 0
    for row in range(len(xyz[0])):
        u, v, w = xyz[0][row], xyz[1][row], xyz[2][row]
        if not is_in_reach(u, v, w):
            beyond += np.isfinite(u) & np.isfinite(v) & np.isfinite(w)
            continue
        x, y, z = np.float32(u), np.float32(v), np.float32(w)
        if (x != 0) | (y != 0) | (z != 0):
            points[count, 0], points[count, 1], points[count, 2] = x, y, z
            kept[count] = row
            count += 1
    return count, beyond


@njit(cache=True, nogil=True)
def small_wholes(column: NDArray[Any], kept: NDArray[np.int32], last: int, values: NDArray[np.uint16]) -> bool:
    """`values[i] = column[kept[i]]`; False, with `values` unfinished, at the first that is not a whole 0…last."""
    for place in range(len(kept)):
        value = column[kept[place]]
        if not (value >= 0 and value <= last) or value != np.floor(value):
            return False
        values[place] = np.uint16(value)
    return True
