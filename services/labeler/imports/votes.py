"""Votes for the classes of map voxels: each occupied voxel of a frame votes for the map voxel that its centre lies in.

**Conventions.** Votes lie in bricks of 8 × 8 × 8 map voxels, found by their keys of `stone.geometry.lattice`; a voxel
has one word, the votes for T in its lowest 21 bits, for P in the next, for N in the highest. At most eight centres
0.2 m apart lie in one voxel, so a count cannot run over before 2^18 frames have voted: it is emptied before. The bricks
are as many as they are; whoever votes is told where they were full.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.geometry.lattice import BIAS, EMPTY, MASK, Keys, indices_of, pack, slot_of
from stone.geometry.se3 import SE3
from stone.labels.grid import GRID_MIN_M, GRID_SHAPE, Grid
from stone.labels.voxels import VOXEL_M

SIDE, SHIFT, CELLS = 8, 3, 512
BITS = 21
MOST_BRICKS = 16384  # 64 MiB of votes
MOST_FRAMES = 1 << 18
WORDS_A_COLUMN = GRID_SHAPE[2] // 8


@dataclass(frozen=True, eq=False)
class VoxelVotes:
    """Map voxels (K,) by key, and the votes (K, 3) of each for T, P and N."""

    keys: Keys
    counts: NDArray[np.uint32]


@dataclass(eq=False)
class VoteBricks:
    """Bricks that votes are counted in, empty at first. `size` is a power of two."""

    size: int = MOST_BRICKS
    _table: Keys = field(init=False)
    _rows: NDArray[np.int32] = field(init=False)
    _keys: Keys = field(init=False)
    _votes: NDArray[np.uint64] = field(init=False)
    _state: NDArray[np.int64] = field(init=False)

    def __post_init__(self) -> None:
        self._table = np.full(2 * self.size, EMPTY, np.int64)
        self._rows = np.zeros(2 * self.size, np.int32)
        self._keys = np.zeros(self.size, np.int64)
        self._votes = np.zeros((self.size, CELLS), np.uint64)
        self._state = np.zeros(2, np.int64)  # bricks used, frames that voted

    def vote(self, classes: Grid, map_from_ego: SE3, begun: int = 0) -> int:
        """Count the votes of a grid, from its column `begun` on; the column at which the bricks were full, else −1.

        Whoever is told of a column empties the bricks and votes on from there. The grid's classes are 0 to 3 and its
        corners lie on the lattice.
        """
        if self._state[1] >= MOST_FRAMES:
            return begun
        words = np.require(classes.reshape(-1), requirements=("C", "A")).view(np.uint64)
        start, step = _placed(map_from_ego)
        bricks = (self._table, self._rows, self._keys, self._votes, self._state)
        column = int(_vote(words, (start, step), begun, bricks))
        self._state[1] += column < 0
        return column

    def emptied(self, tile_bricks: int) -> Iterator[tuple[tuple[int, int], VoxelVotes]]:
        """All votes by the tile that they are in, so many bricks a side in plan; there are none once all are taken."""
        used = int(self._state[0])
        tiles, groups = np.unique(indices_of(self._keys[:used])[:, :2] // tile_bricks, axis=0, return_inverse=True)
        order = np.argsort(groups.reshape(-1), kind="stable")
        ends = np.cumsum(np.bincount(groups.reshape(-1), minlength=len(tiles))).tolist()
        for (i, j), start, stop in zip(tiles.tolist(), [0, *ends], ends, strict=False):
            yield (i, j), self._gathered(order[start:stop])
        self._votes[:used] = 0
        self._table.fill(EMPTY)
        self._state[:] = 0

    def _gathered(self, rows: NDArray[np.int64]) -> VoxelVotes:
        """The votes of these bricks."""
        count = sum(int(np.count_nonzero(self._votes[row])) for row in rows.tolist())
        found = VoxelVotes(np.empty(count, np.int64), np.empty((count, 3), np.uint32))
        _gather((self._keys, self._votes), rows, (found.keys, found.counts))
        return found


def _placed(map_from_ego: SE3) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Where the centre of voxel [0, 0, 0] lies in units of map voxels (3,), and what one further along each axis adds,
    the columns of (3, 3)."""
    step = map_from_ego.rotation()
    first = np.array(GRID_MIN_M) / VOXEL_M + 0.5
    return map_from_ego.translation_m / VOXEL_M + step @ first, np.ascontiguousarray(step)


@njit(cache=True, nogil=True)
def _vote(words, placed, begun, bricks):  # type: ignore[no-untyped-def]
    """A word is eight voxels of a column. The brick of the voxel before is looked at first: it mostly is the same."""
    (start, step), (table, rows, keys, votes, state) = placed, bricks
    last_key, row = np.int64(EMPTY), 0
    for column in range(begun, GRID_SHAPE[0] * GRID_SHAPE[1]):
        a, b = column >> 8, column & 255
        x = start[0] + a * step[0, 0] + b * step[0, 1]
        y = start[1] + a * step[1, 0] + b * step[1, 1]
        z = start[2] + a * step[2, 0] + b * step[2, 1]
        if state[0] + GRID_SHAPE[2] > keys.size:  # a column may need as many new bricks as it has voxels
            return column
        for part in range(WORDS_A_COLUMN):
            word = words[column * WORDS_A_COLUMN + part]
            if word == 0:
                continue
            for c in range(8 * part, 8 * part + 8):
                kind = (word >> np.uint64(8 * (c & 7))) & np.uint64(3)
                if kind == 0:
                    continue
                i = np.int64(np.floor(x + c * step[0, 2]))
                j = np.int64(np.floor(y + c * step[1, 2]))
                k = np.int64(np.floor(z + c * step[2, 2]))
                key = pack(i >> SHIFT, j >> SHIFT, k >> SHIFT)  # type: ignore[arg-type]
                if key != last_key:
                    slot = slot_of(table, key)
                    if table[slot] == EMPTY:
                        table[slot], rows[slot], keys[state[0]] = key, state[0], key
                        state[0] += 1
                    last_key, row = key, rows[slot]
                cell = ((i & 7) << 6) | ((j & 7) << 3) | (k & 7)
                votes[row, cell] += np.uint64(1) << (np.uint64(BITS) * (kind - np.uint64(1)))
    return -1


@njit(cache=True, nogil=True)
def _gather(bricks, rows, out):  # type: ignore[no-untyped-def]
    """The voxels with votes of these bricks, as many as there is room for."""
    (keys, votes), (found, counts), at = bricks, out, 0
    mask = np.uint64((1 << BITS) - 1)
    for row in rows:
        key = keys[row]
        i, j, k = ((key >> 42) - BIAS) << SHIFT, (((key >> 21) & MASK) - BIAS) << SHIFT, ((key & MASK) - BIAS) << SHIFT
        for cell in range(CELLS):
            word = votes[row, cell]
            if word == 0 or at == found.size:
                continue
            found[at] = pack(i + (cell >> 6), j + ((cell >> 3) & 7), k + (cell & 7))
            for kind in range(3):
                counts[at, kind] = (word >> np.uint64(BITS * kind)) & mask
            at += 1
