"""Reads a published dataset: the index of its tables, and the check of its files.

**Conventions.** Four stages: `rows` (each row separately), `links` (consistency of tables), `files` (every file),
`sweeps` (returns against labels, and splits against drives). A stage starts only if all earlier stages found no fault,
because a fault would be repeated in every later stage.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from stone_datasets.annotations import compare_annotations, read_annotations
from stone_datasets.build import NS_PER_US, PlacedData, channels_of, data_of, frames_of
from stone_datasets.classes import OWN_CLASSES, ClassMap
from stone_datasets.drives import torn_drives
from stone_datasets.faults import MOST_SHOWN, DatasetFaultError, DatasetFaults, DatasetPlace
from stone_datasets.files import DatasetFiles, open_dataset
from stone_datasets.grid_fit import GridFit, check_fit
from stone_datasets.index import DatasetChannel, DatasetIndex, DatasetSequence, label_folder
from stone_datasets.labels import FrameLabels, read_labels
from stone_datasets.samples import check_sample
from stone_datasets.splits import check_splits, read_splits, splits_of
from stone_datasets.stamps import are_dated
from stone_datasets.stated_layout import UNSTATED, StatedLayout, form_of_tokens
from stone_datasets.tables import DatasetTables, read_tables
from stone_exports.frames import LIDAR_CHANNEL
from stone_files.byte_ranges import ByteRanges
from stone_files.dataset_layout import ANNOTATIONS

# The content of a dataset, counted while its files are checked.


CLASS_NAMES = ("free", "T", "P", "N")
NS_PER_S = 1e9


@dataclass
class DatasetContents:
    """Counts of files by channel and of voxels by class, and the number of bytes."""

    index: DatasetIndex
    class_map: str
    files_of: Counter[str] = field(default_factory=Counter)
    voxels: Counter[str] = field(default_factory=Counter)
    masks: Counter[str] = field(default_factory=Counter)
    labelled: int = 0
    size_bytes: int = 0
    fit: GridFit | None = None

    def add_labels(self, labels: FrameLabels) -> None:
        occupied = [int(np.count_nonzero(labels.classes == number)) for number in (1, 2, 3)]
        counts = dict(zip(CLASS_NAMES, (labels.classes.size - sum(occupied), *occupied), strict=True))
        self.voxels.update(counts)
        self.labelled += 1
        for name, mask in (("mask_lidar", labels.mask_lidar), ("mask_camera", labels.mask_camera)):
            if mask is not None:
                self.masks[name] += 1
                self.voxels[name] += int(np.count_nonzero(mask))

    def as_record(self) -> dict[str, Any]:
        """Return the record for `--json`. Shares are relative to occupied voxels; null if there are none."""
        occupied = sum(self.voxels[name] for name in CLASS_NAMES[1:])
        index = self.index
        return {
            "layout": index.layout.name,
            "grid": index.grid.as_record(),
            "version": index.files.version,
            "sequences": [_sequence_record(sequence) for sequence in index.sequences],
            "frames": sum(map(len, index.sequences)),
            "labelled_frames": self.labelled,
            "masks": {name: self.masks[name] for name in ("mask_lidar", "mask_camera")},
            "returns_in_occupied": None if self.fit is None else self.fit.as_record(),
            "classes": self.class_map,
            "class_share_of_occupied": {
                name: self.voxels[name] / occupied if occupied else None for name in CLASS_NAMES[1:]
            },
            "voxels": {name: self.voxels[name] for name in CLASS_NAMES},
            "sensors": {name: self.files_of[name] for name in sorted(self.files_of)},
            "splits": {name: list(scenes) for name, scenes in index.splits.items()},
            "size_bytes": self.size_bytes,
        }


def _sequence_record(sequence: DatasetSequence) -> dict[str, Any]:
    seconds = float(sequence.stamps_ns[-1] - sequence.stamps_ns[0]) / NS_PER_S if len(sequence) else 0.0
    return {
        "name": sequence.name,
        "frames": len(sequence),
        "seconds": seconds,
        "is_dated": len(sequence) == 0 or are_dated(sequence.stamps_ns // NS_PER_US),
        "is_labelled": sequence.is_labelled,
        "sensors": sorted(sequence.channels),
        "splits": list(sequence.splits),
    }


# Reads and checks every file of a dataset: samples of all sensors, labels of all frames.


Progress = Callable[[int, int], None]


def check_files(index: DatasetIndex, classes: ClassMap, faults: DatasetFaults, progress: Progress) -> DatasetContents:
    """Return the content of the files; `progress` receives the number of frames done and in total."""
    contents, total, done = DatasetContents(index, classes.name), sum(map(len, index.sequences)), 0
    for sequence in index.sequences:
        for channel in sequence.channels.values():
            _check_channel(channel, contents, faults)
        for frame in range(len(sequence) if sequence.is_labelled else 0):
            _check_labels((sequence, frame), classes, contents, faults)
            progress(done + frame, total)
        done += len(sequence)
        progress(done, total)
    return contents


def _check_channel(channel: DatasetChannel, contents: DatasetContents, faults: DatasetFaults) -> None:
    index = contents.index
    for position, row in enumerate(channel.rows.tolist()):
        at = _place(index, channel, row)
        try:
            span = index.file(channel, position)
            if span is None:
                raise DatasetFaultError("DST-050", at, f"{channel.filename(position)} is missing")
            check_sample(span, channel.sensor, at, has_no_returns=index.layout.has_no_returns)
        except DatasetFaultError as fault:
            faults.add(fault)
            continue
        contents.files_of[channel.sensor.channel] += 1
        contents.size_bytes += span.size_bytes


def _place(index: DatasetIndex, channel: DatasetChannel, row: int) -> DatasetPlace:
    if index.files.version:
        return DatasetPlace(f"{index.files.version}/sample_data.json", row + 1)
    return DatasetPlace(ANNOTATIONS)


def _check_labels(
    of: tuple[DatasetSequence, int], classes: ClassMap, contents: DatasetContents, faults: DatasetFaults
) -> None:
    sequence, frame = of
    try:
        span = contents.index.labels(sequence, frame)
        if span is None:
            raise DatasetFaultError("DST-060", DatasetPlace(sequence.label_name(frame)), "it is missing")
        contents.add_labels(read_labels(span, classes, contents.index.layout))
    except DatasetFaultError as fault:
        faults.add(fault)
        return
    contents.size_bytes += span.size_bytes


Stage = Literal["rows", "links", "files", "sweeps"]


@dataclass(frozen=True)
class DatasetCheck:
    """The result of a check: `contents` only if there are no faults; `reached` is the last stage started."""

    faults: DatasetFaults
    reached: Stage
    contents: DatasetContents | None = field(default=None)


@dataclass(frozen=True, eq=False)
class DatasetReading:
    """The index of a valid dataset, and its tables as columns, or None for a dataset with annotations.json only."""

    index: DatasetIndex
    placed: PlacedData | None


def read_dataset(path: Path, stated: StatedLayout = UNSTATED) -> DatasetIndex:
    """Return the index of the dataset in a folder, tar or zip; opens only the first label file.

    Raises the first `DatasetFaultError`, `bad_tar`.
    """
    return read_tables_of(path, stated).index


def read_tables_of(where: Path | ByteRanges, stated: StatedLayout = UNSTATED) -> DatasetReading:
    """Return the index as `read_dataset` does, with the tables' columns; also for a zip that is read by ranges."""
    faults = DatasetFaults()
    _, reading = _read(open_dataset(where), stated, faults)
    faults.raise_first()
    if reading is None:
        raise AssertionError("an index is missing without a fault that explains it")
    return reading


def check_dataset(
    where: Path | ByteRanges,
    classes: ClassMap = OWN_CLASSES,
    most: int = MOST_SHOWN,
    progress: Progress = lambda _done, _of: None,
    stated: StatedLayout = UNSTATED,
) -> DatasetCheck:
    """Read and check the whole dataset; `progress` receives the number of frames done and in total.

    Raises `bad_tar` if a tar has no readable file, `bad_layout`.
    """
    faults = DatasetFaults(most)
    try:
        reached, reading = _read(open_dataset(where), stated, faults)
    except DatasetFaultError as fault:
        faults.add(fault)
        return DatasetCheck(faults, "rows")
    if reading is None or faults.total:
        return DatasetCheck(faults, reached)
    contents = check_files(reading.index, classes, faults, progress)
    if len(faults):
        return DatasetCheck(faults, "files")
    try:
        contents.fit = check_fit(reading.index, classes)
    except DatasetFaultError as fault:
        faults.add(fault)
    for torn in torn_drives(reading.index):
        faults.add(torn)
    return DatasetCheck(faults, "sweeps", None if len(faults) else contents)


def _read(files: DatasetFiles, stated: StatedLayout, faults: DatasetFaults) -> tuple[Stage, DatasetReading | None]:
    if files.version:
        tables = read_tables(files, faults)
        if len(faults):
            return "rows", None
        reading = _linked(files, tables, stated, faults)
    else:
        index = read_annotations(files, stated, faults)
        reading = None if index is None else DatasetReading(index, None)
    if reading is not None and not reading.index.sequences and not len(faults):
        faults.add(DatasetFaultError("DST-001", DatasetPlace(files.version or ANNOTATIONS), "it has no scenes"))
    return "links", reading


def _linked(
    files: DatasetFiles, tables: DatasetTables, stated: StatedLayout, faults: DatasetFaults
) -> DatasetReading | None:
    """Return the index of valid rows, or None if they are inconsistent."""
    try:
        has_dashes = form_of_tokens(tables.samples.tokens, DatasetPlace(tables.file("sample")))
    except DatasetFaultError as fault:
        faults.add(fault)
        return None
    frames = frames_of(tables, faults)
    placed = None if faults.total else data_of(tables, frames, faults)
    if placed is None or faults.total:
        return None
    sequences = []
    for scene, channels in zip(tables.scenes.values(), channels_of(placed), strict=True):
        start, stop = frames.starts[scene.place : scene.place + 2].tolist()
        tokens = tuple(tables.samples.tokens[row].replace("-", "") for row in frames.order[start:stop].tolist())
        stamps_ns, poses = frames.stamps_ns[start:stop], channels[LIDAR_CHANNEL].map_from_ego
        log, is_labelled = scene.log, files.has_folder(label_folder(scene.name))
        of_log = (log.logfile, log.vehicle, log.location)
        sequences.append(
            DatasetSequence(scene.name, *of_log, tokens, stamps_ns, poses, channels, is_labelled, has_dashes=has_dashes)
        )
    index = DatasetIndex(files, stated.of(files, sequences), tuple(sequences), {})
    return DatasetReading(_with_splits(index, faults), placed)


def _with_splits(index: DatasetIndex, faults: DatasetFaults) -> DatasetIndex:
    try:
        file, splits = read_splits(index.files)
    except DatasetFaultError as fault:
        faults.add(fault)
        return index
    if index.files.span(ANNOTATIONS) is not None:
        annotated = compare_annotations(index, faults)
        file, splits = (file, splits) if splits else (ANNOTATIONS, annotated)
    check_splits((file, splits), [sequence.name for sequence in index.sequences], faults)
    named = splits_of(splits)
    sequences = tuple(replace(sequence, splits=named.get(sequence.name, ())) for sequence in index.sequences)
    return replace(index, sequences=sequences, splits=splits)
