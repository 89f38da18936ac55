"""Points, times and rings out of a LiDAR cloud, whatever its driver calls them.

**Conventions.** Points without a return are NaN, infinite or (0, 0, 0) and are dropped. Points out of reach
(`stone.sensors.reach`) are dropped and counted. `stone_recordings.messages.point_times` reads the times; a point of a
timed sweep without a time is dropped. Source: Hesai ROS 2.0, Nebula, Velodyne and Ouster drivers.
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
    """N returns: (N, 3) float32 metres in the LiDAR frame, and if the cloud contains them, times and lasers.

    `offset_ns` is relative to the header stamp; `time_meaning` is how it was read ("absolute s", "relative ns", "none",
    "another clock", "too coarse"). `rows` (N,) are the records of the returns in the cloud. `beyond` counts the points
    out of any LiDAR's reach. `wrapped`, `filled` and `untimed` (dropped) count times as in `PointTimes`.
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
        """The number of points without a time of the sweep as recorded."""
        return self.wrapped + self.filled + self.untimed


def resolve_points(
    points: NDArray[np.void], stamp_ns: int, *, with_ring: bool = True, clock: PointClock | None = None
) -> LidarPoints:
    """Return the returns of a cloud; `clock` is that of its points if it differs from the header's.

    Raises: CloudLayoutError without x, y, z of one floating type.
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
    """Raise CloudLayoutError if a point has no x, y, z of one floating type."""
    names = record.names or ()
    codes = {record[name].str for name in "xyz" if name in names}
    if not set("xyz") <= set(names) or codes not in ({"<f4"}, {"<f8"}):
        raise CloudLayoutError(f"x, y and z must be floats of one size, its fields are {', '.join(names)}"[:200])


def _packed(points: NDArray[np.void]) -> tuple[NDArray[np.float32], NDArray[np.int32], int]:
    """Return the returns, their rows, and the number of points out of reach."""
    xyz = np.empty((len(points), 3), np.float32)
    kept = np.empty(len(points), np.int32)
    count, beyond = pack_points((points["x"], points["y"], points["z"]), xyz, kept)
    return xyz[:count], kept[:count], beyond


def _rings(points: NDArray[np.void], kept: NDArray[np.int32]) -> NDArray[np.uint16] | None:
    """Return the first nominated field that holds small whole numbers."""
    for name in RING_NAMES:
        if name not in (points.dtype.names or ()) or points.dtype[name].kind not in "fiu":
            continue
        values = np.empty(len(kept), np.uint16)
        if small_wholes(points[name], kept, LAST_RING, values):
            return values
    return None


# The hot loops of reading a cloud: unaligned columns of its records in, packed returns out. Columns are fields of a
# structured view, unaligned and strided; only returns are copied. No fastmath: NaN and −0 must differ from numbers as
# in IEEE 754.


@njit(cache=True, nogil=True)
def pack_points(
    xyz: tuple[NDArray[Any], NDArray[Any], NDArray[Any]], points: NDArray[np.float32], kept: NDArray[np.int32]
) -> tuple[int, int]:
    """Fill `points` (N, 3) with every non-zero point in reach and `kept` (N,) with its row.

    Returns their number, and the number of finite points out of reach; NaN and ±inf mean no return.
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
    """Set `values[i] = column[kept[i]]`; return False, with `values` unfinished, at the first that is not a whole
    0…last.
    """
    for index in range(len(kept)):
        value = column[kept[index]]
        if not (value >= 0 and value <= last) or value != np.floor(value):
            return False
        values[index] = np.uint16(value)
    return True
