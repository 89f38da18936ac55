"""The metric lattice: voxel indices, their 64-bit keys, and an open-addressing table from key to row.

**Conventions.** Voxel index = floor(p / size) per axis, half-open. A key packs the three indices, each biased by
2^20 into 21 bits, x highest, so sorted keys are in x, y, z order. At 0.1 m the lattice spans ±104 km.
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.errors import Refused

BIAS = 1 << 20
MASK = (1 << 21) - 1
EMPTY = -1

Keys = NDArray[np.int64]


@njit(inline="always")
def pack(i: int, j: int, k: int) -> np.int64:
    """Return the key of voxel (i, j, k)."""
    return ((np.int64(i) + BIAS) << 42) | ((np.int64(j) + BIAS) << 21) | (np.int64(k) + BIAS)


@njit(inline="always")
def scatter(key: np.int64) -> np.uint64:
    """Return the Fibonacci hash (Knuth, TAOCP 3, 6.4); the xor moves the high bits into the range of the mask."""
    mixed = np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)
    return mixed ^ (mixed >> np.uint64(32))


@njit(inline="always")
def slot_of(table_keys: Keys, key: np.int64) -> np.int64:
    """Return the slot of `key` in a table with free slots, or the `EMPTY` slot where it would be inserted."""
    mask = np.uint64(table_keys.size - 1)
    slot = scatter(key) & mask
    while table_keys[slot] != key and table_keys[slot] != EMPTY:
        slot = (slot + np.uint64(1)) & mask
    return np.int64(slot)


@njit(inline="always")
def find(table_keys: Keys, table_rows: NDArray[np.int32], key: np.int64) -> int:
    """Return the row of `key`, or −1."""
    slot = slot_of(table_keys, key)
    row: int = table_rows[slot] if table_keys[slot] == key else -1
    return row


@njit(cache=True, nogil=True)
def _fill(keys: Keys, table_keys: Keys, table_rows: NDArray[np.int32]) -> None:
    for row in range(keys.size):
        slot = slot_of(table_keys, keys[row])
        table_keys[slot] = keys[row]
        table_rows[slot] = row


@dataclass(frozen=True, eq=False)
class VoxelTable:
    """Key → row, at most half full; both arrays have a power-of-two length."""

    keys: Keys
    rows: NDArray[np.int32]


def table_of(keys: Keys) -> VoxelTable:
    """Return the table that maps each of the distinct `keys` to its row."""
    slots = 1 << max(4, math.ceil(math.log2(max(len(keys), 1))) + 1)
    table = VoxelTable(np.full(slots, EMPTY, np.int64), np.zeros(slots, np.int32))
    _fill(keys, table.keys, table.rows)
    return table


@njit(cache=True, nogil=True)
def _keys_of(points: NDArray[np.float64], size_m: float, out: Keys) -> None:
    inverse = 1.0 / size_m
    for p in range(points.shape[0]):
        out[p] = pack(
            math.floor(points[p, 0] * inverse), math.floor(points[p, 1] * inverse), math.floor(points[p, 2] * inverse)
        )


def keys_of(points: NDArray[np.float64], size_m: float) -> Keys:
    """Return the voxel key of each point (N, 3), metres.

    Raises `off_lattice` if a coordinate is not finite or off the lattice.
    """
    check_reach(points, size_m)
    keys = np.empty(len(points), np.int64)
    _keys_of(np.ascontiguousarray(points, np.float64), size_m, keys)
    return keys


def check_reach(points: NDArray[np.float64], size_m: float) -> None:
    """Raise `off_lattice` unless every coordinate fits the lattice with this voxel size."""
    reach_m = float(np.max(np.abs(points), initial=0.0))
    limit_m = (BIAS - 2) * size_m
    if not reach_m < limit_m:  # also raises for NaN
        raise Refused(
            "off_lattice",
            f"coordinates are up to {reach_m:g} m from the map origin, but the lattice ends at {limit_m:g} m: "
            "is a pose broken or given in global (UTM, ECEF) coordinates?",
        )


def indices_of(keys: Keys) -> NDArray[np.int64]:
    """Return the voxel indices (N, 3) of keys (N,)."""
    return np.stack([(keys >> 42) - BIAS, ((keys >> 21) & MASK) - BIAS, (keys & MASK) - BIAS], axis=1)


def keys_from_indices(indices: NDArray[np.int64]) -> Keys:
    """Return the keys (N,) of voxel indices (N, 3)."""
    biased = indices.astype(np.int64) + BIAS
    return np.asarray((biased[:, 0] << 42) | (biased[:, 1] << 21) | biased[:, 2], dtype=np.int64)


def centres_of(keys: Keys, size_m: float) -> NDArray[np.float64]:
    """Return the voxel centres (N, 3), metres."""
    return np.asarray((indices_of(keys) + 0.5) * size_m, dtype=np.float64)
