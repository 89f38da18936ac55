"""Bit planes as runs of equal columns: neighbouring columns are often equal, and runs are fast to expand.

**Conventions.** Planes (3, W) uint64, W a multiple of 32, are 6 · W columns of one uint32 in this order. Bit n of
`changes` is set if column n differs from the previous one (always for the first); `columns` are these columns.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.errors import ShapeError
from stone.kernels.column_words import unroll8
from stone.scoring.frame_counts import Planes
from stone.scoring.plane_layout import WHOLE

PLANES = 3


@dataclass(frozen=True, eq=False)
class PlaneRuns:
    """`changes` (6 · W / 64,) uint64, with one set bit for each entry of `columns` (R,) uint32."""

    changes: NDArray[np.uint64]
    columns: NDArray[np.uint32]


def runs_of(planes: Planes) -> PlaneRuns:
    """Return the runs of planes. Raises `ShapeError` for other shapes than (3, a multiple of 32)."""
    if len(planes.shape) != 2 or planes.shape[0] != PLANES or 2 * planes.shape[1] % WHOLE or not planes.size:
        raise ShapeError("planes", planes.shape, f"({PLANES}, a multiple of {WHOLE // 2})")
    columns = np.ascontiguousarray(planes).view(np.uint32).reshape(-1)
    is_new = np.concatenate([[True], columns[1:] != columns[:-1]])
    return PlaneRuns(np.packbits(is_new, bitorder="little").view(np.uint64), columns[is_new])


def planes_of(runs: PlaneRuns) -> Planes:
    """Return the planes (3, W) of these runs.

    Raises `ShapeError` if changes and columns do not match.
    """
    changes, columns = runs.changes, runs.columns
    if changes.ndim != 1 or not changes.size or changes.size % PLANES or not changes[0] & np.uint64(1):
        raise ShapeError("changes", changes.shape, f"a multiple of {PLANES}, with the first bit set")
    if columns.shape != (int(np.bitwise_count(changes).sum(dtype=np.int64)),):
        raise ShapeError("columns", columns.shape, "one entry for each set bit of changes")
    planes = np.empty((PLANES, 32 * changes.size // PLANES), np.uint64)
    _unroll(changes, columns, planes.view(np.uint32).reshape(-1))
    return planes


@njit(cache=True, nogil=True)
def _unroll(changes: NDArray[np.uint64], columns: NDArray[np.uint32], out: NDArray[np.uint32]) -> None:
    run = np.int64(-1)
    for w in range(changes.size):
        bits = changes[w]
        if bits == 0:
            same = columns[run]
            for n in range(64):
                out[64 * w + n] = same
        elif run >= 0 and run + 64 + 8 < columns.size:  # the entries read in advance exist
            for n in range(0, 64, 8):
                run += unroll8(np.uint32((bits >> np.uint64(n)) & np.uint64(0xFF)), columns, run, out, 64 * w + n)
        else:
            for n in range(64):
                run += np.int64((bits >> np.uint64(n)) & np.uint64(1))
                out[64 * w + n] = columns[run]
