"""The map of a scene fused from the labels of its frames, tile by tile.

    grids → votes in bricks → votes of tiles in files → of each voxel the class of most votes

**Conventions.** Tiles are of `TILE_VOXELS` a side in plan, which are whole bricks. Of equal votes the more cautious
class wins, N before P before T. Memory holds the bricks and one tile, whatever the number of frames: votes of a tile
are put together in its file before there are twice as many as after the last time, and refused beyond
`MOST_TILE_VOXELS`.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from services.labeler.imports.votes import SIDE, VoteBricks, VoxelVotes
from services.labeler.run import Tile
from services.labeler.scratch import tile_name
from stone.geometry.lattice import Keys
from stone.geometry.se3 import SE3
from stone.labels.grid import Grid
from stone_datasets.faults import DatasetPlace
from stone_datasets.file_faults import MapTooDenseError

TILE_VOXELS = 240
MOST_TILE_VOXELS = 1 << 24
LEAST_RECORDS = 1 << 21
VOTE = np.dtype([("key", "<i8"), ("counts", "<u4", 3)])


@dataclass(eq=False)
class FusedLabels:
    """Votes of the frames of the scene called `name`, kept in files of the folder `scratch`."""

    name: str
    scratch: Path
    bricks: VoteBricks = field(default_factory=VoteBricks)
    _records: dict[Tile, int] = field(default_factory=dict)
    _merged: dict[Tile, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.scratch.mkdir(parents=True)

    def add(self, classes: Grid, map_from_ego: SE3) -> None:
        """The votes of a frame. Raises `MapTooDenseError`."""
        column = self.bricks.vote(classes, map_from_ego)
        while column >= 0:
            self._spill()
            column = self.bricks.vote(classes, map_from_ego, column)

    def tiles(self) -> Iterator[tuple[Tile, Keys, NDArray[np.uint8]]]:
        """Every tile with its voxels (K,), sorted, and their classes (K,), in the order of tiles."""
        self._spill()
        for tile in sorted(self._records):
            votes = self._merged_votes(tile)
            yield tile, votes["key"].astype(np.int64), _elected(votes["counts"])

    def _spill(self) -> None:
        """Put the votes of the bricks into the files of their tiles."""
        for place, votes in self.bricks.emptied(TILE_VOXELS // SIDE):
            self._append(Tile(*place), votes)

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
        """Each voxel of the tile once, by key. Raises `MapTooDenseError`."""
        held = np.fromfile(self._path(tile), VOTE)
        keys = np.ascontiguousarray(held["key"])
        order = np.argsort(keys)
        keys = keys[order]
        first = np.flatnonzero(np.append(True, np.diff(keys) != 0)[: len(keys)])
        if len(first) > MOST_TILE_VOXELS:
            what = (
                f"labels of {self.name} occupy {len(first)} voxels of 48 m × 48 m, at most {MOST_TILE_VOXELS} are read"
            )
            raise MapTooDenseError(DatasetPlace(f"gts/{self.name}"), what)
        merged = np.empty(len(first), VOTE)
        merged["key"], merged["counts"] = keys[first], np.add.reduceat(held["counts"][order], first, axis=0)
        return merged

    def _path(self, tile: Tile) -> Path:
        return self.scratch / f"{tile_name(tile)}.votes"


def _elected(counts: NDArray[np.uint32]) -> NDArray[np.uint8]:
    """The class (K,) of most votes (K, 3)."""
    return np.asarray(3 - counts[:, ::-1].argmax(axis=1), dtype=np.uint8)
