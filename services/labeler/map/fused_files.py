"""Compact files of fused tiles: point sums and observed voxels of one part.

**Conventions.** The format is lossless, and equal maps give equal files: a column's width follows from its values
alone. A voxel takes about 30 bytes instead of 72. Cells are mixed-radix, x highest, and therefore sorted like the keys.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stone.geometry.corners import corners_of
from stone.geometry.lattice import Keys, indices_of, keys_from_indices
from stone.labels.observed_voxels import Observed
from stone.surface.pointmap import COUNT, FRAMES, OFFSET, VIEW, PointMap

Columns = Mapping[str, NDArray[np.generic]]
Plan = tuple[NDArray[np.int64], NDArray[np.int64]]  # half-open range of voxel indices (2,) along x and y

WIDTHS = (np.uint8, np.int8, np.uint16, np.int16, np.uint32, np.int32)


def fused_columns(points: PointMap, observed: Observed) -> dict[str, NDArray[np.generic]]:
    """Return the arrays from which `fused_points` and `fused_observed` restore the two values."""
    box, cells = _cells_of(points.keys)
    return {
        "box": box,
        "cells": cells,
        "counts": _narrow(points.moments[:, COUNT]),
        "frames": _narrow(points.moments[:, FRAMES]),
        "offsets": _narrow(points.moments[:, OFFSET]),
        "views": _narrow(points.moments[:, VIEW]),
        "bricks": observed.keys,
        "words": observed.words,
        "since": _narrow(observed.since),
    }


def fused_points(columns: Columns, voxel_m: float, plan: Plan | None = None) -> PointMap:
    """Return the point map of these columns, or its part in `plan`."""
    box, cells = columns["box"], columns["cells"]
    rows = slice(None) if plan is None else _rows_in(plan, box, cells)
    keys = _keys_in(box, cells[rows])
    moments = np.empty((len(keys), 8), np.int64)
    if len(keys):  # otherwise the other columns are not read
        moments[:, COUNT], moments[:, FRAMES] = columns["counts"][rows], columns["frames"][rows]
        moments[:, OFFSET], moments[:, VIEW] = columns["offsets"][rows], columns["views"][rows]
    return PointMap(voxel_m, keys, moments)


def fused_observed(columns: Columns) -> Observed:
    """Return the observed bricks of these columns."""
    bricks, words = columns["bricks"].astype(np.int64, copy=False), columns["words"].astype(np.uint64, copy=False)
    return Observed(bricks, words, columns["since"].astype(np.int32))


def _cells_of(keys: Keys) -> tuple[NDArray[np.int64], NDArray[np.generic]]:
    """Return the box (2, 3) around the voxels, as low corner and extent, and each voxel's cell (M,) in it."""
    if not len(keys):
        return np.zeros((2, 3), np.int64), np.zeros(0, np.uint8)
    indices = indices_of(keys)
    low, high = corners_of(indices)
    extent = high - low + 1
    i, j, k = (indices - low).T
    return np.stack([low, extent]), _narrow((i * extent[1] + j) * extent[2] + k)


def _keys_in(box: NDArray[np.generic], cells: NDArray[np.generic]) -> Keys:
    if not len(cells):
        return np.zeros(0, np.int64)
    low, extent = box.astype(np.int64)
    rows, k = np.divmod(cells.astype(np.int64), extent[2])
    i, j = np.divmod(rows, extent[1])
    return keys_from_indices(np.stack([i, j, k], axis=1) + low)


def _rows_in(plan: Plan, box: NDArray[np.generic], cells: NDArray[np.generic]) -> slice | NDArray[np.intp]:
    """Return the cells in the rectangle: by their order along x, by their index along y."""
    low, extent = box.astype(np.int64)
    first, end = (np.clip(bound - low[:2], 0, extent[:2]) for bound in plan)
    rows = slice(*np.searchsorted(cells, np.array([first[0], end[0]]) * extent[1] * extent[2]))
    if first[1] == 0 and end[1] == extent[1]:
        return rows
    j = cells[rows].astype(np.int64) // extent[2] % extent[1]
    return np.asarray(rows.start + np.flatnonzero((first[1] <= j) & (j < end[1])))


def _narrow(values: NDArray[np.integer[Any]]) -> NDArray[np.generic]:
    """Return the numbers in the narrowest type that holds all of them."""
    if not values.size:
        return values.astype(np.uint8)
    low, high = corners_of(values.reshape(len(values), -1))
    least, most = int(low.min()), int(high.max())
    fits = (width for width in WIDTHS if np.iinfo(width).min <= least and most <= np.iinfo(width).max)
    return values.astype(next(fits, np.int64))
