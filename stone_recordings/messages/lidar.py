"""Points, times and rings out of a LiDAR cloud, whatever its driver calls them.

**Conventions.** Points without a return are NaN, infinite or (0, 0, 0) and are dropped, and so are those out of reach
(`stone.sensors.reach`), which are counted. A time field is recognised by its values:
the unit is the one in which a cloud lasts between 1 ms and 1 s; it is absolute when the values are a date, relative to
the header stamp otherwise. Names only nominate fields. Source: Hesai ROS 2.0, Nebula, Velodyne and Ouster drivers.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.sensors.reach import is_in_reach
from stone_recordings.bags.errors import CloudLayoutError

NS_PER_S = 1_000_000_000
TIME_NAMES = ("timestamp", "time_stamp", "time", "t", "offset_time", "timeStamp", "ts")
RING_NAMES = ("ring", "channel", "laser_id", "line")
LAST_RING = 1023
# Nanoseconds per unit; a sweep of 1 to 1000 Hz lasts 1e6 to 1e9 ns, so at most one unit fits a spread of values.
UNIT_NAMES = {NS_PER_S: "s", 1_000_000: "ms", 1_000: "µs", 1: "ns"}
UNITS_NS = tuple(UNIT_NAMES)
LEAST_SWEEP_NS, LAST_SWEEP_NS = 1e6, 1e9
# Dates begin here (1973): no offset within a sweep is that long.
FIRST_DATE_NS = 1e17
# An absolute time further from the stamp than this is another clock's, and says nothing about this stamp.
LAST_CLOCK_DISTANCE_NS = 5 * NS_PER_S


@dataclass(frozen=True, eq=False)
class LidarPoints:
    """N returns: (N, 3) float32 metres in the LiDAR frame, and where the cloud says so when and by which laser.

    `offset_ns` is relative to the header stamp; `time_meaning` says how it was read ("absolute s", "relative ns",
    "none", "another clock"); `rows` (N,) are the records of the cloud that the returns are, and `beyond` counts those
    that are places out of any LiDAR's reach.
    """

    points_lidar: NDArray[np.float32]
    offset_ns: NDArray[np.int64] | None
    ring: NDArray[np.uint16] | None
    time_meaning: str
    rows: NDArray[np.int32]
    beyond: int


def resolve_points(points: NDArray[np.void], stamp_ns: int, *, with_ring: bool = True) -> LidarPoints:
    """Raises: CloudLayoutError when there are no x, y, z of one floating type."""
    check_xyz(points.dtype)
    xyz, kept, beyond = _packed(points)
    offset_ns, meaning = _offsets(points, kept, stamp_ns)
    return LidarPoints(xyz, offset_ns, _rings(points, kept) if with_ring else None, meaning, kept, beyond)


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


def _offsets(points: NDArray[np.void], kept: NDArray[np.int32], stamp_ns: int) -> tuple[NDArray[np.int64] | None, str]:
    """The first nominated field whose values are times."""
    meaning = "none"
    for name in TIME_NAMES:
        if name not in (points.dtype.names or ()) or points.dtype[name].kind not in "fiu" or not len(kept):
            continue
        offset_ns, meaning = offsets_from_values(points[name], kept, stamp_ns)
        if offset_ns is not None:
            return offset_ns, meaning
    return None, meaning


def offsets_from_values(
    column: NDArray[Any], kept: NDArray[np.int32], stamp_ns: int
) -> tuple[NDArray[np.int64] | None, str]:
    """Offsets of `column[kept]` from the stamp in ns, and how they were read; None where they are no times."""
    least, last = span(column, kept)
    length = last - least
    unit_ns = next((unit for unit in UNITS_NS if LEAST_SWEEP_NS < length * unit <= LAST_SWEEP_NS), None)
    if unit_ns is None:
        return None, "none"
    unit, offset_ns = UNIT_NAMES[unit_ns], np.empty(len(kept), np.int64)
    if abs(least) * unit_ns < FIRST_DATE_NS:
        scaled(column, kept, 0.0, float(unit_ns), offset_ns)
        return offset_ns, f"relative {unit}"
    if abs(least * unit_ns - stamp_ns) > LAST_CLOCK_DISTANCE_NS:
        return None, "another clock"
    # Whole units of the stamp are taken off first: what is left keeps every digit that the field had.
    whole, rest_ns = divmod(stamp_ns, unit_ns)
    scaled(column, kept, float(whole), float(unit_ns), offset_ns)
    offset_ns -= rest_ns
    return offset_ns, f"absolute {unit}"


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
def span(column: NDArray[Any], kept: NDArray[np.int32]) -> tuple[float, float]:
    """Least and last of `column[kept]`, NaN twice where one of them is not finite; `kept` is not empty."""
    least, last = np.inf, -np.inf
    for row in kept:
        value = np.float64(column[row])
        if not np.isfinite(value):
            return np.nan, np.nan
        least, last = min(least, value), max(last, value)
    return least, last


@njit(cache=True, nogil=True)
def scaled(
    column: NDArray[Any], kept: NDArray[np.int32], whole: float, unit_ns: float, offset_ns: NDArray[np.int64]
) -> None:
    """`offset_ns[i] = round((column[kept[i]] − whole) · unit_ns)`, half to even."""
    for place in range(len(kept)):
        offset_ns[place] = np.int64(np.rint((np.float64(column[kept[place]]) - whole) * unit_ns))


@njit(cache=True, nogil=True)
def small_wholes(column: NDArray[Any], kept: NDArray[np.int32], last: int, values: NDArray[np.uint16]) -> bool:
    """`values[i] = column[kept[i]]`; False, with `values` unfinished, at the first that is not a whole 0…last."""
    for place in range(len(kept)):
        value = column[kept[place]]
        if not (value >= 0 and value <= last) or value != np.floor(value):
            return False
        values[place] = np.uint16(value)
    return True
