"""Reads a published dataset: the index of all that its tables say, and the check of all that its files hold.

**Conventions.** Three stages: `rows` (every row by itself), `links` (how tables fit together), `files` (every file). A
stage begins where those before found nothing wrong, since one fault would be told again by each that builds on it.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from stone_datasets.annotations import compare_annotations, read_annotations
from stone_datasets.build import PlacedData, channels_of, data_of, frames_of
from stone_datasets.classes import OWN_CLASSES, ClassMap
from stone_datasets.contents import DatasetContents
from stone_datasets.faults import MOST_SHOWN, DatasetFaultError, DatasetFaults, DatasetPlace
from stone_datasets.file_check import Progress, check_files
from stone_datasets.files import DatasetFiles, open_dataset
from stone_datasets.index import DatasetIndex, DatasetSequence, label_folder
from stone_datasets.splits import check_splits, read_splits, splits_of
from stone_datasets.tables import DatasetTables, read_tables
from stone_exports.frames import LIDAR_CHANNEL
from stone_files.dataset_layout import ANNOTATIONS, NotADatasetError

Stage = Literal["rows", "links", "files"]


@dataclass(frozen=True)
class DatasetCheck:
    """What a check found. `contents` only where there are no faults, `reached` is the last stage that was begun."""

    faults: DatasetFaults
    reached: Stage
    contents: DatasetContents | None = field(default=None)


@dataclass(frozen=True, eq=False)
class DatasetReading:
    """The index of a sound dataset, and what its tables say as columns; those None where annotations.json has all."""

    index: DatasetIndex
    placed: PlacedData | None


def read_dataset(path: Path) -> DatasetIndex:
    """The index of the dataset in a folder or tar; its files are not opened.

    Raises the first `DatasetFaultError` that is found, `BadTarError`.
    """
    return read_tables_of(path).index


def read_tables_of(path: Path) -> DatasetReading:
    """As `read_dataset`, with the columns of its tables."""
    faults = DatasetFaults()
    _, reading = _read(open_dataset(path), faults)
    faults.raise_first()
    if reading is None:
        raise AssertionError("an index is missing and no fault says why")
    return reading


def check_dataset(
    path: Path, classes: ClassMap = OWN_CLASSES, most: int = MOST_SHOWN, progress: Progress = lambda _done, _of: None
) -> DatasetCheck:
    """Everything read; `progress` is told frames done and all. Raises `BadTarError` where no file can be found."""
    faults = DatasetFaults(most)
    try:
        reached, reading = _read(open_dataset(path), faults)
    except DatasetFaultError as fault:
        faults.add(fault)
        return DatasetCheck(faults, "rows")
    if reading is None or faults.total:
        return DatasetCheck(faults, reached)
    contents = check_files(reading.index, classes, faults, progress)
    return DatasetCheck(faults, "files", None if len(faults) else contents)


def _read(files: DatasetFiles, faults: DatasetFaults) -> tuple[Stage, DatasetReading | None]:
    if files.version:
        tables = read_tables(files, faults)
        if len(faults):
            return "rows", None
        reading = _linked(files, tables, faults)
    else:
        index = read_annotations(files, faults)
        reading = None if index is None else DatasetReading(index, None)
    if reading is not None and not reading.index.sequences and not len(faults):
        faults.add(NotADatasetError(DatasetPlace(files.version or ANNOTATIONS), "it has no scenes"))
    return "links", reading


def _linked(files: DatasetFiles, tables: DatasetTables, faults: DatasetFaults) -> DatasetReading | None:
    """The index of sound rows; None where they do not fit together."""
    frames = frames_of(tables, faults)
    placed = None if faults.total else data_of(tables, frames, faults)
    if placed is None or faults.total:
        return None
    sequences = []
    for scene, channels in zip(tables.scenes.values(), channels_of(placed), strict=True):
        start, stop = frames.starts[scene.place : scene.place + 2].tolist()
        tokens = tuple(tables.samples.tokens[row] for row in frames.order[start:stop].tolist())
        stamps_ns, poses = frames.stamps_ns[start:stop], channels[LIDAR_CHANNEL].map_from_ego
        log, is_labelled = scene.log, files.has_folder(label_folder(scene.name))
        of_log = (log.logfile, log.vehicle, log.location)
        sequences.append(DatasetSequence(scene.name, *of_log, tokens, stamps_ns, poses, channels, is_labelled))
    return DatasetReading(_with_splits(DatasetIndex(files, "release", tuple(sequences), {}), faults), placed)


def _with_splits(index: DatasetIndex, faults: DatasetFaults) -> DatasetIndex:
    try:
        file, splits = read_splits(index.files)
    except DatasetFaultError as fault:
        faults.add(fault)
        return index
    if index.files.span(ANNOTATIONS) is not None:
        annotated = compare_annotations(index, faults)
        file, splits = (file, splits) if splits else (ANNOTATIONS, annotated)
    check_splits((file, splits), [one.name for one in index.sequences], faults)
    named = splits_of(splits)
    sequences = tuple(replace(one, splits=named.get(one.name, ())) for one in index.sequences)
    return replace(index, sequences=sequences, splits=splits)
