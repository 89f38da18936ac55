"""The order of a grid's columns in its bit planes: sorted by range ring, each ring one contiguous run of words.

**Conventions.** A column is one uint32 of a plane, for every grid height. A ring is the horizontal distance of the
column's centre from the ego origin, half-open: 0–10, 10–20, from 20 m. Each ring has an even number of positions, and
all rings together a multiple of `WHOLE`; unused positions at the end of a ring are 0.
"""

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from stone_base.label_grid import PAPER, LabelGrid

RING_EDGES_M = (10.0, 20.0)
RINGS = len(RING_EDGES_M) + 1
# Columns counted at a time: their planes (32 KiB) stay in the L1 cache and cause no page faults.
CHUNK = 4096
WHOLE = 64


@dataclass(frozen=True, eq=False)
class PlaneLayout:
    """The positions of a grid's columns in a plane of `columns` positions; `bounds` (4,) are the rings' bounds.

    `runs` (R, 3) are source column, position and length; `chunks` (C, 6) ring, first position, end, end of the used
    positions, first run and end of the runs.
    """

    grid: LabelGrid
    bounds: NDArray[np.int64]
    runs: NDArray[np.int64]
    chunks: NDArray[np.int64]

    @property
    def columns(self) -> int:
        return int(self.bounds[-1])

    @property
    def words(self) -> int:
        """The length of a plane as uint64."""
        return self.columns // 2


def column_rings(grid: LabelGrid = PAPER) -> NDArray[np.int64]:
    """Return the ring of each column (X · Y,), x slowest."""
    x_m, y_m = (grid.min_m[axis] + (np.arange(grid.shape[axis]) + 0.5) * grid.voxel_m for axis in (0, 1))
    distance_m = np.hypot(x_m[:, None], y_m[None, :])
    return np.asarray(np.digitize(distance_m, RING_EDGES_M).ravel(), dtype=np.int64)


@lru_cache(maxsize=16)
def layout_of(grid: LabelGrid) -> PlaneLayout:
    """Return the layout of a grid's planes."""
    rings = column_rings(grid)
    order, sizes = np.argsort(rings, kind="stable"), np.bincount(rings, minlength=RINGS)
    spare = sizes % 2
    spare[-1] += -(sizes + spare).sum() % WHOLE
    bounds = np.concatenate([[0], np.cumsum(sizes + spare)])
    places = np.arange(len(order)) + np.repeat(np.cumsum(spare) - spare, sizes)
    starts = np.concatenate([np.arange(low, high, CHUNK) for low, high in pairwise(bounds)])
    stops = np.append(starts[1:], bounds[-1])
    is_break = np.diff(order) != 1
    breaks = np.unique(np.concatenate([[0], np.flatnonzero(is_break) + 1, np.searchsorted(places, starts)]))
    breaks = breaks[breaks < len(order)]
    runs = np.stack([order[breaks], places[breaks], np.diff(np.append(breaks, len(order)))], axis=1)
    ring_of = np.searchsorted(bounds, starts, side="right") - 1
    ends = np.minimum(stops, (bounds[:-1] + sizes)[ring_of])
    first, last = np.searchsorted(runs[:, 1], starts), np.searchsorted(runs[:, 1], stops)
    chunks = np.stack([ring_of, starts, stops, ends, first, last], axis=1)
    return PlaneLayout(grid, bounds.astype(np.int64), runs.astype(np.int64), chunks.astype(np.int64))
