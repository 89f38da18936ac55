"""The index of a dataset: its sequences with frames, poses and calibrated sensors, and the file of every datum.

**Conventions.** A scene is a sequence, a sample is a frame with the same token: 32 hex digits, also if the dataset
writes all its sample tokens as UUIDs with dashes. Frames are sorted by stamp. `map_from_ego` equals `ego_pose` to the
last bit: the map is the dataset's `global`. Times are nanoseconds, from stamps in integer microseconds. Arrays are per
sequence; files are opened only when they are read.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from stone.geometry.se3 import SE3
from stone_base.label_grid import LabelGrid
from stone_datasets.columns import NameColumn
from stone_datasets.files import DatasetFiles
from stone_exports.files import ExportFileSpan
from stone_exports.frames import ExportedSensor
from stone_files.dataset_layouts import DatasetLayout, dashed_token


@dataclass(frozen=True, eq=False)
class DatasetChannel:
    """One sensor in a sequence: its frames (K,), ascending, with the stamp and ego pose of each.

    `rows` (K,) are the positions of its files in `names`.
    """

    sensor: ExportedSensor
    frames: NDArray[np.int64]
    stamps_ns: NDArray[np.int64]
    map_from_ego: SE3
    rows: NDArray[np.int64]
    names: NameColumn = field(repr=False)

    def filename(self, index: int) -> str:
        """Return the file name of the datum number `index`."""
        return self.names[int(self.rows[index])]


@dataclass(frozen=True, eq=False)
class DatasetSequence:
    """One scene; `splits` are the splits that contain it, `is_labelled` is true if all its frames have labels
    (otherwise none).

    With `has_dashes` the dataset writes `tokens` as UUIDs.
    """

    name: str
    logfile: str
    vehicle: str
    location: str
    tokens: tuple[str, ...]
    stamps_ns: NDArray[np.int64]
    map_from_ego: SE3
    channels: Mapping[str, DatasetChannel]
    is_labelled: bool
    splits: tuple[str, ...] = ()
    has_dashes: bool = False

    def __len__(self) -> int:
        return len(self.tokens)

    def label_name(self, index: int) -> str:
        """Return the file name of a frame's labels."""
        return label_name(self.name, self.tokens[index], has_dashes=self.has_dashes)


@dataclass(frozen=True, eq=False)
class DatasetIndex:
    """All sequences, in the order of the table `scene`, and the splits with their names."""

    files: DatasetFiles
    layout: DatasetLayout
    sequences: tuple[DatasetSequence, ...]
    splits: Mapping[str, tuple[str, ...]]

    @property
    def grid(self) -> LabelGrid:
        """The grid of the labels."""
        return self.layout.grid

    def file(self, channel: DatasetChannel, index: int) -> ExportFileSpan | None:
        """Return the file of a channel's datum number `index`, or None if it is missing. Raises `DST-004`."""
        return self.files.span(channel.filename(index))

    def labels(self, sequence: DatasetSequence, index: int) -> ExportFileSpan | None:
        """Return the file of a frame's labels, or None if it is missing."""
        return self.files.span(sequence.label_name(index))


def label_folder(sequence: str) -> str:
    return f"gts/{sequence}"


def label_name(sequence: str, token: str, *, has_dashes: bool) -> str:
    """Return the label file name of the frame with this token."""
    return f"{label_folder(sequence)}/{dashed_token(token) if has_dashes else token}/labels.npz"
