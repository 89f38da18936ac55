"""The hot loop of reading a cloud: three unaligned floats a point, kept when they are a return.

**Conventions.** Works on bits, so coordinates come out exactly as they were recorded. A coordinate is NaN or infinite
when its exponent bits are all set; it is zero, of either sign, when all but the sign are clear (IEEE 754).
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

_EXPONENT = np.uint32(0x7F800000)
_MAGNITUDE = np.uint32(0x7FFFFFFF)
_ZERO = np.uint32(0)


@njit(cache=True, nogil=True, inline="always")
def _word(rows: NDArray[np.uint8], row: int, at: int) -> np.uint32:
    return (
        np.uint32(rows[row, at])
        | (np.uint32(rows[row, at + 1]) << np.uint32(8))
        | (np.uint32(rows[row, at + 2]) << np.uint32(16))
        | (np.uint32(rows[row, at + 3]) << np.uint32(24))
    )


@njit(cache=True, nogil=True)
def pack_points(
    rows: NDArray[np.uint8], x_at: int, y_at: int, z_at: int, bits: NDArray[np.uint32], kept: NDArray[np.int32]
) -> int:
    """Fill `bits` (N, 3) with the float32 bits of every return and `kept` (N,) with its row; gives how many."""
    count = 0
    for row in range(rows.shape[0]):
        x, y, z = _word(rows, row, x_at), _word(rows, row, y_at), _word(rows, row, z_at)
        is_finite = (x & _EXPONENT) != _EXPONENT and (y & _EXPONENT) != _EXPONENT and (z & _EXPONENT) != _EXPONENT
        if is_finite and ((x | y | z) & _MAGNITUDE) != _ZERO:
            bits[count, 0], bits[count, 1], bits[count, 2] = x, y, z
            kept[count] = row
            count += 1
    return count
