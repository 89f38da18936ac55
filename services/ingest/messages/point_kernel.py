"""The hot loops of reading a cloud: unaligned columns of its records in, packed returns out.

**Conventions.** Columns are fields of a structured view, unaligned and strided; nothing of them is copied before it is
known to be a return. No fastmath: NaN and −0 must be told apart from numbers as IEEE 754 does.
"""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, nogil=True)
def pack_points(
    xyz: tuple[NDArray[Any], NDArray[Any], NDArray[Any]], points: NDArray[np.float32], kept: NDArray[np.int32]
) -> int:
    """Fill `points` (N, 3) with every finite, non-zero point and `kept` (N,) with its row; gives how many.

    Doubles are rounded to float32 first: what overflows is no return.
    """
    count = 0
    for row in range(len(xyz[0])):
        x, y, z = np.float32(xyz[0][row]), np.float32(xyz[1][row]), np.float32(xyz[2][row])
        is_finite = np.isfinite(x) & np.isfinite(y) & np.isfinite(z)
        if is_finite & ((x != 0) | (y != 0) | (z != 0)):
            points[count, 0], points[count, 1], points[count, 2] = x, y, z
            kept[count] = row
            count += 1
    return count


@njit(cache=True, nogil=True)
def gather(column: NDArray[Any], kept: NDArray[np.int32], values: NDArray[np.float64]) -> None:
    """`values[i] = column[kept[i]]`; exact for every field type of a cloud."""
    for place in range(len(kept)):
        values[place] = column[kept[place]]
