"""Frames of a published dataset in the form of exports: the file of each sensor and of the labels.

**Conventions.** In an archive, all files are located when the frames are placed, so that placed frames can be sent to
other processes. The archive's name index is valid in one process only (`stone_datasets/files.py`). Files are opened
only when they are read.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from stone_datasets.build import NS_PER_US
from stone_datasets.files import DatasetFiles, DatasetTar
from stone_datasets.index import DatasetIndex, DatasetSequence
from stone_datasets.reading import read_dataset
from stone_datasets.zip_files import DatasetZip, Places, placed_span
from stone_exports.files import ExportFileSpan
from stone_exports.frames import LIDAR_CHANNEL, ExportedDatum, ExportedFrame
from stone_files.byte_ranges import ByteRanges, LocalRanges
from stone_files.dataset_layouts import DatasetLayout

LABELS = ""  # as a channel of a sequence


@dataclass(frozen=True, eq=False)
class PlacedFrames:
    """The frames of all sequences. `places` are each channel's file positions, by sequence; None for a folder."""

    sequences: tuple[DatasetSequence, ...]
    layout: DatasetLayout
    splits: Mapping[str, tuple[str, ...]]
    folder: DatasetFiles | None
    archive: tuple[ByteRanges, str] | None
    places: tuple[Mapping[str, Places], ...] = field(repr=False)

    def __iter__(self) -> Iterator[ExportedFrame]:
        return (self.frame(number, at) for number, sequence in enumerate(self.sequences) for at in range(len(sequence)))

    def frame(self, number: int, at: int) -> ExportedFrame:
        """Return the frame at this position of a sequence; sensors and labels with missing files are left out."""
        sequence, data = self.sequences[number], dict[str, ExportedDatum]()
        for name, channel in sequence.channels.items():
            index = int(np.searchsorted(channel.frames, at))
            if index == len(channel.frames) or channel.frames[index] != at:
                continue
            span = self._span((number, name, index), channel.filename(index))
            if span is not None:
                stamp_us = int(channel.stamps_ns[index]) // NS_PER_US
                data[name] = ExportedDatum(channel.sensor, stamp_us, channel.map_from_ego[index], span)
        labels = self._span((number, LABELS, at), sequence.label_name(at)) if sequence.is_labelled else None
        stamp_us = int(sequence.stamps_ns[at]) // NS_PER_US
        return ExportedFrame(sequence.tokens[at], sequence.name, stamp_us, data, labels)

    def _span(self, of: tuple[int, str, int], name: str) -> ExportFileSpan | None:
        if self.archive is None:
            return None if self.folder is None else self.folder.span(name)
        (ranges, root), (number, channel, at) = self.archive, of
        span = self.places[number][channel][at]
        return None if span[0] < 0 else placed_span(ranges, (name, root + name), span)


def placed_frames(index: DatasetIndex) -> PlacedFrames:
    """Locate the files of all frames of a dataset."""
    files, contents = index.files, (index.sequences, index.layout, index.splits)
    if not isinstance(files, DatasetTar | DatasetZip):
        return PlacedFrames(*contents, files, None, ())
    ranges = files.ranges if isinstance(files, DatasetZip) else LocalRanges(files.path)
    places = []
    for sequence in index.sequences:
        sequence_places = {LABELS: files.spans(map(sequence.label_name, range(len(sequence))))}
        for name, channel in sequence.channels.items():
            sequence_places[name] = files.spans(map(channel.filename, range(len(channel.frames))))
        places.append(sequence_places)
    return PlacedFrames(*contents, None, (ranges, files.root), tuple(places))


def swept_frames(path: Path) -> tuple[ExportedFrame, ...]:
    """Return every frame with a sweep of a published dataset. Raises a `DatasetFaultError`."""
    return tuple(frame for frame in placed_frames(read_dataset(path)) if LIDAR_CHANNEL in frame.data)
