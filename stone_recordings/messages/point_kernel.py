"""The hot loops of reading a cloud: unaligned columns of its records in, packed returns out.

**Conventions.** Columns are fields of a structured view, unaligned and strided; nothing of them is copied before it is
known to be a return. No fastmath: NaN and −0 must be told apart from numbers as IEEE 754 does.
"""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.sensors.reach import is_in_reach


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
