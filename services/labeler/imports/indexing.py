"""The work of a sandboxed child that indexes a dataset: it checks the tables and divides them by scene.

**Conventions.** Only the sensor and label files of some frames are opened, to check that they fit together, and in
Occ3D's layout the first picture of each camera, for its size. All data are streamed; memory grows by a few hundred
bytes per row.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from services.labeler.imports.answers import DatasetIndexAnswer, ExtraFileAnswer, IndexedSceneAnswer
from services.labeler.imports.scene_parts import (
    EXTRA,
    TABLES,
    DatasetOpening,
    SceneAbout,
    extra_path,
    scene_folder,
    write_scene_parts,
)
from services.labeler.imports.sequences import annotated_data, placed_data, sequence_of
from services.runtime.sandbox import ProgressCallback
from stone.sensors.sequence import Sequence
from stone.splits.surroundings import REGION, UNSAID
from stone_datasets.annotations import write_annotated_tables
from stone_datasets.build import PlacedData
from stone_datasets.extra_files import ExtraFiles, extra_files
from stone_datasets.faults import DatasetPlace
from stone_datasets.files import DatasetArchive
from stone_datasets.grid_fit import check_fit
from stone_datasets.index import DatasetIndex
from stone_datasets.reading import read_tables_of
from stone_datasets.scene_spans import SceneSpans, annotated_spans, table_spans
from stone_datasets.scene_tables import write_scene_tables, write_splits
from stone_files.dataset_faults import DatasetFaultError

Scene = tuple[Sequence, SceneSpans]
UNKNOWN = "unknown"  # the region in STONE's own exports if unspecified


def index_dataset(opening: DatasetOpening, folder: Path, progress: ProgressCallback) -> bytes:
    """Write `scenes/<ordinal>/` and, for each file outside the tables, `extra/<number>`; return a `DatasetIndexAnswer`.

    Raises the first `DatasetFaultError`, `bad_tar`.
    """
    progress("check", 0, 1)
    reading = read_tables_of(opening.dataset, opening.stated)
    progress("check", 1, 1)
    index, tar = reading.index, reading.index.files
    if not isinstance(tar, DatasetArchive):
        raise DatasetFaultError(
            "DST-001", DatasetPlace(index.files.path.name), "it is a folder; only a tar or zip can be imported"
        )
    check_fit(index, opening.classes)
    inputs = {opening.name: opening.sha256}
    for ordinal in range(len(index.sequences)):
        (folder / scene_folder(ordinal) / TABLES).mkdir(parents=True)
    placed = reading.placed
    scenes = _annotated(index, tar, inputs) if placed is None else _tabled(index, tar, (placed, inputs))
    known = set[int]()
    for ordinal, (sequence, spans) in enumerate(scenes):
        known.update(np.concatenate([spans.places[:, 0], spans.labels[:, 0]]).tolist())
        about = SceneAbout(
            tar.version, tar.root, index.layout.name, index.grid.as_record(), index.sequences[ordinal].has_dashes
        )
        write_scene_parts(folder / scene_folder(ordinal), about, sequence, spans)
        progress("index", ordinal, len(index.sequences))
    progress("index", len(index.sequences), len(index.sequences))
    _write_tables(index, placed, folder)
    progress("part", 1, 1)
    extra = extra_files(tar, known)
    _copy_extra(extra, folder)
    return _answer(index, extra).packed()


def _copy_extra(extra: ExtraFiles, folder: Path) -> None:
    (folder / EXTRA).mkdir()
    for number, span in enumerate(extra.kept):
        with extra_path(folder, number).open("wb") as file:
            for piece in span.pieces():
                file.write(piece)


def _tabled(index: DatasetIndex, tar: DatasetArchive, of: tuple[PlacedData, dict[str, str]]) -> Iterator[Scene]:
    placed, inputs = of
    order = np.argsort(placed.scene, kind="stable")
    bounds = np.searchsorted(placed.scene[order], np.arange(len(index.sequences) + 1)).tolist()
    for ordinal, spans in enumerate(table_spans(tar, placed, index.sequences)):
        data = placed_data(placed, order[bounds[ordinal] : bounds[ordinal + 1]])
        yield sequence_of(index.sequences[ordinal], data, inputs, index.grid), spans


def _annotated(index: DatasetIndex, tar: DatasetArchive, inputs: dict[str, str]) -> Iterator[Scene]:
    for scene in index.sequences:
        yield sequence_of(scene, annotated_data(scene), inputs, index.grid), annotated_spans(tar, scene)


def _write_tables(index: DatasetIndex, placed: PlacedData | None, folder: Path) -> None:
    folders = [folder / scene_folder(ordinal) / TABLES for ordinal in range(len(index.sequences))]
    if placed is not None:
        write_scene_tables(index.files, placed, folders.__getitem__)
    for scene, of_scene in zip(index.sequences, folders, strict=True):
        if placed is None:
            write_annotated_tables(scene, of_scene)
        write_splits(of_scene, scene.name, scene.splits)


def region_of(location: str) -> str:
    """Return the region in a log's `location`, with dashes for blanks; "" if it has none, for example coordinates."""
    name = "-".join(location.split())
    return name if REGION.fullmatch(name) and name.casefold() != UNKNOWN else UNSAID


def _answer(index: DatasetIndex, extra: ExtraFiles) -> DatasetIndexAnswer:
    return DatasetIndexAnswer(
        extra=[ExtraFileAnswer(name=file.name, size_bytes=file.size_bytes) for file in extra.kept],
        left_out=[ExtraFileAnswer(name=name, size_bytes=size_bytes) for name, size_bytes in extra.left_out],
        left_out_total=extra.left_out_total,
        scenes=[
            IndexedSceneAnswer(
                ordinal=ordinal,
                name=scene.name,
                frames=len(scene),
                is_labelled=scene.is_labelled,
                splits=scene.splits,
                region=region_of(scene.location),
            )
            for ordinal, scene in enumerate(index.sequences)
        ],
    )
