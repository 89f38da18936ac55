"""A dataset as a sequence of frames, independent of its layout on disk.

**Conventions.** Opening reads the list of files, the tables and the first label file, which determines the layout;
every other file is read at the first access of its frame. Frames are not cached. A dataset can be pickled and read in
other processes.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, overload

import numpy as np

from stone_base.errors import Refused
from stone_base.label_grid import LabelGrid
from stone_client.devkit.frame import Frame, LabelFormat
from stone_client.devkit.label_set import LABELS, is_label_set, read_label_set
from stone_client.devkit.published import read_published
from stone_datasets.classes import OWN_CLASSES, read_class_map
from stone_datasets.stated_layout import StatedLayout
from stone_files.atomic import atomic_directory
from stone_files.grid_file import GRID_FILE, chosen_grid, grid_text
from stone_files.npz import npz_bytes
from stone_submissions.manifest import Manifest, write_manifest

if TYPE_CHECKING:
    from stone_client.devkit.tensors import FrameTensors

Arrays = Mapping[str, Any]


class FrameSource(Protocol):
    """The frames of a layout, by sequence and index."""

    @property
    def format(self) -> LabelFormat: ...

    def tokens(self, sequence: str) -> tuple[str, ...]: ...

    @property
    def sequences(self) -> tuple[str, ...]: ...

    @property
    def splits(self) -> Mapping[str, tuple[str, ...]]: ...

    @property
    def drives(self) -> tuple[tuple[str, ...], ...]: ...

    def frame(self, sequence: str, at: int) -> Frame: ...


def labels_of(frame: Frame) -> Arrays:
    """Return the arrays that every frame has in the same shape."""
    return {"token": frame.token, "semantics": frame.semantics, "observed": frame.observed}


class Dataset(Sequence[Frame]):
    """Frames by sequence and stamp; `sequences` are the names of its sequences."""

    def __init__(self, source: FrameSource, sequences: Iterable[str]) -> None:
        self._source = source
        self.sequences = tuple(sequences)
        self._ends = np.cumsum([len(source.tokens(name)) for name in self.sequences])

    @property
    def grid(self) -> LabelGrid:
        """The grid of the labels."""
        return self._source.format.layout.grid

    @property
    def layout(self) -> str:
        """The name of the layout: paper, release or occ3d."""
        return self._source.format.layout.name

    @property
    def splits(self) -> Mapping[str, tuple[str, ...]]:
        """The names of the sequences of each split of the dataset."""
        return {split: tuple(filter(self.sequences.__contains__, of)) for split, of in self._source.splits.items()}

    @property
    def drives(self) -> tuple[tuple[str, ...], ...]:
        """The names of the sequences of each drive: sequences that continue each other, which no split may separate."""
        own = (tuple(filter(self.sequences.__contains__, names)) for names in self._source.drives)
        return tuple(filter(None, own))

    def select(self, sequences: Iterable[str]) -> "Dataset":
        """Return the frames of these sequences. Raises `unknown_sequence`."""
        names = tuple(sequences)
        if unknown := [name for name in names if name not in self.sequences]:
            raise Refused("unknown_sequence", f"the dataset has no sequence {unknown[0][:100]!r}")
        return Dataset(self._source, names)

    def write_manifest(self, path: str | Path) -> None:
        """Write the list of its frames, for `stone baseline`, `train`, `predict` and `validate`."""
        write_manifest(Path(path), Manifest(self._tokens(), self.grid))

    def write_labels(self, folder: str | Path) -> None:
        """Write its labels into a new folder, frame by frame, for `stone score`. Raises `frame_unlabelled`."""
        with atomic_directory(Path(folder)) as staging:
            (staging / GRID_FILE).write_text(grid_text(self.grid), "utf-8")
            for frame in self:
                path = staging / LABELS / frame.sequence / frame.token / "labels.npz"
                path.parent.mkdir(parents=True)
                observed = frame.observed.astype(np.uint8)
                path.write_bytes(npz_bytes({"semantics": frame.semantics, "mask_lidar": observed}))

    def as_torch(self, read: Callable[[Frame], Arrays] = labels_of) -> "FrameTensors":
        """Return a torch `Dataset` that yields the arrays of `read(frame)` as tensors. Requires torch."""
        from stone_client.devkit.tensors import FrameTensors

        return FrameTensors(self, read)

    def _tokens(self) -> dict[str, tuple[str, ...]]:
        return {name: self._source.tokens(name) for name in self.sequences}

    def __len__(self) -> int:
        return int(self._ends[-1]) if len(self._ends) else 0

    @overload
    def __getitem__(self, index: int) -> Frame: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Frame]: ...
    def __getitem__(self, index: int | slice) -> Frame | Sequence[Frame]:
        if isinstance(index, slice):
            return [self[at] for at in range(*index.indices(len(self)))]
        at = index + len(self) if index < 0 else index
        if not 0 <= at < len(self):
            raise IndexError(f"frame {index} is out of range: the dataset has {len(self)} frames")
        number = int(np.searchsorted(self._ends, at, "right"))
        before = int(self._ends[number - 1]) if number else 0
        return self._source.frame(self.sequences[number], at - before)

    def __repr__(self) -> str:
        of = f"{len(self)} frames in {len(self.sequences)} sequences"
        return f"<Dataset of {of}, {self.layout} layout, grid {self.grid}>"


def open_dataset(
    path: str | Path, *, layout: str | None = None, grid: str | None = None, classes: str | Path | None = None
) -> Dataset:
    """Open a published dataset, an export (folder, tar or ZIP) or a folder of labels.

    `layout` and `grid` (a name or a file) are recognised if they are not given; `grid` chooses one of several grids in
    a label set. `classes` maps foreign class numbers.

    Raises a `DatasetFaultError` with table, row and file, `bad_tar`, `bad_layout`, `bad_grid`, `not_labels`.
    """
    where, chosen = Path(path), None if grid is None else chosen_grid(grid)
    if is_label_set(where):
        source: FrameSource = read_label_set(where, chosen)
    else:
        class_map = OWN_CLASSES if classes is None else read_class_map(Path(classes))
        source = read_published(where, StatedLayout(layout, chosen), class_map)
    return Dataset(source, source.sequences)
