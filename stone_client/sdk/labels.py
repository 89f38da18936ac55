"""The labels of a sequence as NumPy arrays."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from shutil import rmtree
from weakref import finalize

import numpy as np
from numpy.typing import NDArray

from stone_base.label_grid import LabelGrid
from stone_client.devkit import Dataset, Frame, open_dataset

ARRAYS = ("semantics", "observed")


class Labels(Mapping[str, "NDArray[np.uint8]"]):
    """The labels of all frames of a sequence, in time order.

        labels = stone.labels("forest")
        labels["semantics"]          # (frames, X, Y, Z) uint8: 0 free or unknown, 1 T, 2 P, 3 N
        labels["observed"]           # the same shape: 1 if a ray reached or passed the voxel
        labels.frames[0].semantics   # one frame at a time: of a long sequence the whole array needs gigabytes

    The files lie in `folder`; without one of the caller's they are deleted with this object.
    """

    def __init__(self, folder: Path, stamps_ns: Mapping[str, int], *, is_temporary: bool = False) -> None:
        self.folder = folder
        if is_temporary:
            finalize(self, rmtree, folder, ignore_errors=True)
        self._dataset = open_dataset(folder)
        by_token = {frame.token: frame for frame in self._dataset}
        self.frames: Sequence[Frame] = [by_token[token] for token in stamps_ns]
        """The frames; their arrays are read at their first use."""
        self.stamps_ns = np.array(list(stamps_ns.values()), np.int64)
        """The LiDAR stamp of each frame, in nanoseconds."""

    @property
    def dataset(self) -> Dataset:
        """The labels as a `stone_client.devkit` dataset; `as_torch()` converts them to tensors."""
        return self._dataset

    @property
    def grid(self) -> LabelGrid:
        """The grid of the labels around the robot."""
        return self._dataset.grid

    @property
    def tokens(self) -> tuple[str, ...]:
        """The frame tokens."""
        return tuple(frame.token for frame in self.frames)

    def __getitem__(self, name: str) -> NDArray[np.uint8]:
        """Return `semantics` or `observed` of all frames, (frames, X, Y, Z) uint8. Raises KeyError."""
        if name not in ARRAYS:
            raise KeyError(f"{name!r}; labels have {', '.join(ARRAYS)}")
        stacked = np.empty((len(self.frames), *self.grid.shape), np.uint8)
        for row, frame in zip(stacked, self.frames, strict=True):
            row[...] = frame.semantics if name == "semantics" else frame.observed
        return stacked

    def __iter__(self) -> Iterator[str]:
        return iter(ARRAYS)

    def __len__(self) -> int:
        return len(ARRAYS)

    def __repr__(self) -> str:
        return f"<Labels of {len(self.frames)} frames, grid {self.grid}>"
