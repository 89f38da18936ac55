"""The map of a scene fused from the labels of its frames, tile by tile.

    grids → votes in bricks → votes of tiles in files → the class of most votes per voxel

**Conventions.** Tiles are `TILE_VOXELS` a side in plan, which are whole bricks. If votes are equal, the more cautious
class wins, N before P before T. Memory holds the bricks and one tile, whatever the number of frames. A tile's file is
compacted before its votes double, and the import is refused beyond `MOST_TILE_VOXELS`.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray

from services.labeler.run import Tile
from services.labeler.scratch import tile_name
from stone.geometry.lattice import BIAS, EMPTY, MASK, Keys, indices_of, pack, slot_of
from stone.geometry.se3 import SE3
from stone.labels.grid import Grid
from stone.labels.voxels import VOXEL_M
from stone_base.label_grid import PAPER, LabelGrid
from stone_datasets.faults import DatasetPlace
from stone_files.dataset_faults import DatasetFaultError

# Votes for the classes of map voxels: each occupied voxel of a frame votes for the map voxel that contains its centre.
# A voxel of a coarser grid votes as cubes of 0.2 m. Votes are in bricks of 8 × 8 × 8 map voxels, found by their keys of
# `stone.geometry.lattice`. A voxel has one word with 21 bits for T (lowest), P and N. At most eight centres 0.2 m apart
# are in one voxel, so a count cannot overflow before 2^18 frames have voted; the bricks are emptied earlier. The number
# of bricks is fixed; `vote` returns the column at which they were full.


SIDE, SHIFT, CELLS = 8, 3, 512
BITS = 21
MOST_BRICKS = 16384  # 64 MiB of votes
MOST_FRAMES = 1 << 18


@dataclass(frozen=True, eq=False)
class VoxelVotes:
    """Map voxels (K,) by key, and their votes (K, 3) for T, P and N."""

    keys: Keys
    counts: NDArray[np.uint32]


@dataclass(eq=False)
class VoteBricks:
    """Bricks in which votes are counted, initially empty. `size` is a power of two."""

    size: int = MOST_BRICKS
    grid: LabelGrid = PAPER
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
        self._state = np.zeros(2, np.int64)  # used bricks, frames that voted

    def vote(self, classes: Grid, map_from_ego: SE3, begun: int = 0) -> int:
        """Count the votes of a grid from column `begun` on; return the column at which the bricks were full, else −1.

        The caller then empties the bricks and continues at that column. The grid's classes are 0 to 3 and its corners
        are on the lattice.
        """
        if self._state[1] >= MOST_FRAMES:
            return begun
        words = np.require(classes.reshape(-1), requirements=("C", "A")).view(np.uint64)
        start, step = _cube_steps(map_from_ego, self.grid)
        bricks = (self._table, self._rows, self._keys, self._votes, self._state)
        column = int(_vote(words, (start, step, self.grid.pooled), (self.grid.shape, begun), bricks))
        self._state[1] += column < 0
        return column

    def emptied(self, tile_bricks: int) -> Iterator[tuple[tuple[int, int], VoxelVotes]]:
        """Yield and remove all votes by tile; a tile has `tile_bricks` bricks per side in plan."""
        used = int(self._state[0])
        tiles, groups = np.unique(indices_of(self._keys[:used])[:, :2] // tile_bricks, axis=0, return_inverse=True)
        order = np.argsort(groups.reshape(-1), kind="stable")
        ends = np.cumsum(np.bincount(groups.reshape(-1), minlength=len(tiles))).tolist()
        for (i, j), start, stop in zip(tiles.tolist(), [0, *ends], ends, strict=False):
            yield (i, j), self._gather_votes(order[start:stop])
        self._votes[:used] = 0
        self._table.fill(EMPTY)
        self._state[:] = 0

    def _gather_votes(self, rows: NDArray[np.int64]) -> VoxelVotes:
        """Return the votes of these bricks."""
        count = sum(int(np.count_nonzero(self._votes[row])) for row in rows.tolist())
        votes = VoxelVotes(np.empty(count, np.int64), np.empty((count, 3), np.uint32))
        _gather((self._keys, self._votes), rows, (votes.keys, votes.counts))
        return votes


def _cube_steps(map_from_ego: SE3, grid: LabelGrid) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the centre (3,) of the first cube of voxel [0, 0, 0] in map voxels, and the steps between cubes.

    The steps along each axis are the columns of (3, 3).
    """
    step = map_from_ego.rotation()
    first = np.array(grid.min_m) / VOXEL_M + 0.5
    return map_from_ego.translation_m / VOXEL_M + step @ first, np.ascontiguousarray(step)


@njit(cache=True, nogil=True)
def _vote(words, placed, columns, bricks):  # type: ignore[no-untyped-def]
    """Count votes, eight voxels of a column per word; the previous voxel's brick is tried first."""
    (start, step, pooled), (shape, begun), (table, rows, keys, votes, state) = placed, columns, bricks
    last_key, row, words_a_column, cubes = np.int64(EMPTY), 0, shape[2] // 8, pooled**3
    for column in range(begun, shape[0] * shape[1]):
        a, b = column // shape[1] * pooled, column % shape[1] * pooled
        x = start[0] + a * step[0, 0] + b * step[0, 1]
        y = start[1] + a * step[1, 0] + b * step[1, 1]
        z = start[2] + a * step[2, 0] + b * step[2, 1]
        if state[0] + shape[2] * cubes > keys.size:  # a column may need as many new bricks as it has cubes
            return column
        for part in range(words_a_column):
            word = words[column * words_a_column + part]
            if word == 0:
                continue
            for voxel in range(8 * part, 8 * part + 8):
                kind = (word >> np.uint64(8 * (voxel & 7))) & np.uint64(3)
                if kind == 0:
                    continue
                for cube in range(cubes):
                    e, f = cube // (pooled * pooled), cube // pooled % pooled
                    c = voxel * pooled + cube % pooled
                    i = np.int64(np.floor(x + e * step[0, 0] + f * step[0, 1] + c * step[0, 2]))
                    j = np.int64(np.floor(y + e * step[1, 0] + f * step[1, 1] + c * step[1, 2]))
                    k = np.int64(np.floor(z + e * step[2, 0] + f * step[2, 1] + c * step[2, 2]))
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
    """Write the voxels with votes of these bricks, up to the length of `out`."""
    (keys, votes), (out_keys, counts), at = bricks, out, 0
    mask = np.uint64((1 << BITS) - 1)
    for row in rows:
        key = keys[row]
        i, j, k = ((key >> 42) - BIAS) << SHIFT, (((key >> 21) & MASK) - BIAS) << SHIFT, ((key & MASK) - BIAS) << SHIFT
        for cell in range(CELLS):
            word = votes[row, cell]
            if word == 0 or at == out_keys.size:
                continue
            out_keys[at] = pack(i + (cell >> 6), j + ((cell >> 3) & 7), k + (cell & 7))
            for kind in range(3):
                counts[at, kind] = (word >> np.uint64(BITS * kind)) & mask
            at += 1


TILE_VOXELS = 240
MOST_TILE_VOXELS = 1 << 24
LEAST_RECORDS = 1 << 21
VOTE = np.dtype([("key", "<i8"), ("counts", "<u4", 3)])


@dataclass(eq=False)
class FusedLabels:
    """Votes of the frames of the scene called `name`, in files of the folder `scratch`."""

    name: str
    scratch: Path
    bricks: VoteBricks = field(default_factory=VoteBricks)
    _records: dict[Tile, int] = field(default_factory=dict)
    _merged: dict[Tile, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.scratch.mkdir(parents=True)

    def add(self, classes: Grid, map_from_ego: SE3) -> None:
        """Add the votes of a frame. Raises `DST-072`."""
        column = self.bricks.vote(classes, map_from_ego)
        while column >= 0:
            self._spill()
            column = self.bricks.vote(classes, map_from_ego, column)

    def tiles(self) -> Iterator[tuple[Tile, Keys, NDArray[np.uint8]]]:
        """Yield every tile in order, with its sorted voxels (K,) and their classes (K,)."""
        self._spill()
        for tile in sorted(self._records):
            votes = self._merged_votes(tile)
            yield tile, votes["key"].astype(np.int64), _elect_classes(votes["counts"])

    def _spill(self) -> None:
        """Move the votes of the bricks into the files of their tiles."""
        for position, votes in self.bricks.emptied(TILE_VOXELS // SIDE):
            self._append(Tile(*position), votes)

    def _append(self, tile: Tile, votes: VoxelVotes) -> None:
        records = np.empty(len(votes.keys), VOTE)
        records["key"], records["counts"] = votes.keys, votes.counts
        with self._path(tile).open("ab") as file:
            file.write(records.tobytes())
        self._records[tile] = self._records.get(tile, 0) + len(records)
        if self._records[tile] > max(LEAST_RECORDS, 2 * self._merged.get(tile, 0)):
            merged = self._merged_votes(tile)
            self._path(tile).write_bytes(merged.tobytes())
            self._records[tile] = self._merged[tile] = len(merged)

    def _merged_votes(self, tile: Tile) -> NDArray[np.void]:
        """Return each voxel of the tile once, by key. Raises `DST-072`."""
        held = np.fromfile(self._path(tile), VOTE)
        keys = np.ascontiguousarray(held["key"])
        order = np.argsort(keys)
        keys = keys[order]
        first = np.flatnonzero(np.append(True, np.diff(keys) != 0)[: len(keys)])
        if len(first) > MOST_TILE_VOXELS:
            what = (
                f"labels of {self.name} occupy {len(first)} voxels of 48 m × 48 m, but at most {MOST_TILE_VOXELS} are "
                "read"
            )
            raise DatasetFaultError("DST-072", DatasetPlace(f"gts/{self.name}"), what)
        merged = np.empty(len(first), VOTE)
        merged["key"], merged["counts"] = keys[first], np.add.reduceat(held["counts"][order], first, axis=0)
        return merged

    def _path(self, tile: Tile) -> Path:
        return self.scratch / f"{tile_name(tile)}.votes"


def _elect_classes(counts: NDArray[np.uint32]) -> NDArray[np.uint8]:
    """Return the class (K,) with most votes (K, 3)."""
    return np.asarray(3 - counts[:, ::-1].argmax(axis=1), dtype=np.uint8)
