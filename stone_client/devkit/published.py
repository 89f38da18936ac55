"""A published dataset or an export, in a folder, tar or ZIP, as frames; its drives by log, stamps and poses."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from stone_client.devkit.frame import Frame, LabelFormat
from stone_datasets.classes import ClassMap
from stone_datasets.drives import drives_among
from stone_datasets.placed_frames import PlacedFrames, placed_frames
from stone_datasets.reading import read_dataset
from stone_datasets.stated_layout import StatedLayout


@dataclass(frozen=True, eq=False)
class PublishedDataset:
    """The frames of a dataset; `numbers` are the indices of its sequences by name."""

    placed: PlacedFrames
    format: LabelFormat
    numbers: Mapping[str, int] = field(repr=False)

    @property
    def sequences(self) -> tuple[str, ...]:
        """The names of the sequences."""
        return tuple(self.numbers)

    def tokens(self, sequence: str) -> tuple[str, ...]:
        """Return the frame tokens of a sequence."""
        return self.placed.sequences[self.numbers[sequence]].tokens

    @property
    def splits(self) -> Mapping[str, tuple[str, ...]]:
        """The names of the sequences of each split of the dataset."""
        return self.placed.splits

    @cached_property
    def drives(self) -> tuple[tuple[str, ...], ...]:
        """The names of the sequences of each drive: sequences that continue each other."""
        return drives_among(self.placed.sequences)

    def frame(self, sequence: str, at: int) -> Frame:
        """Return the frame at this index of a sequence."""
        number = self.numbers[sequence]
        of = self.placed.sequences[number]
        pose = of.map_from_ego[at].as_matrix()
        return Frame(self.placed.frame(number, at), int(of.stamps_ns[at]), pose, self.format)


def read_published(path: Path, stated: StatedLayout, classes: ClassMap) -> PublishedDataset:
    """Read the tables of a dataset and, if no layout is stated, its first label file.

    Raises a `DatasetFaultError`, `bad_tar`, `bad_layout`.
    """
    placed = placed_frames(read_dataset(path, stated))
    numbers = {sequence.name: number for number, sequence in enumerate(placed.sequences)}
    return PublishedDataset(placed, LabelFormat(placed.layout, classes), numbers)
