"""The positions of each scene's files in a dataset's archive, under their names in exports.

**Conventions.** If a key-frame datum or label file is missing, the first is refused. Missing files of maps, or of
sweeps between frames, are left out, because no result uses them. Each datum keeps its table row (from 0), so that a
fault of its file names that row.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from stone_datasets.annotations import picture_names
from stone_datasets.build import PlacedData
from stone_datasets.faults import DatasetPlace, quoted
from stone_datasets.files import DatasetArchive
from stone_datasets.index import DatasetSequence
from stone_datasets.json_stream import json_rows
from stone_datasets.zip_files import PLACE
from stone_files.archives import NAME
from stone_files.dataset_faults import DatasetFaultError
from stone_files.dataset_layout import ANNOTATIONS

MAPS = "maps/"


@dataclass(frozen=True, eq=False)
class SceneSpans:
    """N files of sensors and maps: `names`, the archive's names `held`, `places` (N, 6) in it (`PLACE`), their
    `channels` ("" for a map) and their table `rows` (N,). `labels` (F, 6) are the places of each frame's labels.
    """

    names: tuple[str, ...]
    held: tuple[str, ...]
    places: NDArray[np.int64]
    channels: tuple[str, ...]
    rows: NDArray[np.int64]
    labels: NDArray[np.int64]


def table_spans(
    tar: DatasetArchive, placed: PlacedData, sequences: tuple[DatasetSequence, ...]
) -> Iterator[SceneSpans]:
    """Yield the spans of each scene in the release's layout. Raises a `DatasetFaultError`."""
    names = placed.tables.data.names
    places = tar.spans(names[row] for row in range(len(names)))
    lost = np.flatnonzero((places[:, 0] < 0) & placed.is_key)
    if len(lost):
        raise DatasetFaultError("DST-050", placed.place(int(lost[0])), f"{names[int(lost[0])]} is missing")
    order = np.argsort(placed.scene, kind="stable")
    order = order[places[order, 0] >= 0]
    bounds = np.searchsorted(placed.scene[order], np.arange(len(sequences) + 1))
    maps, logs = _maps(tar, placed), [scene.row.values["log_token"] for scene in placed.tables.scenes.values()]
    for number, sequence in enumerate(sequences):
        rows = order[bounds[number] : bounds[number + 1]]
        drawn = maps.get(logs[number], ())
        named = (*(names[row] for row in rows.tolist()), *drawn)
        channels = (*(placed.sensor(row).sensor.channel for row in rows.tolist()), *("" for _ in drawn))
        every = np.concatenate([places[rows], tar.spans(drawn)])
        every_row = np.concatenate([rows, np.full(len(drawn), -1, np.int64)])
        held = tuple(f"{tar.root}{name}" for name in named)
        yield SceneSpans(named, held, every, channels, every_row, label_places(tar, sequence))


def annotated_spans(tar: DatasetArchive, sequence: DatasetSequence) -> SceneSpans:
    """Return the spans of a scene in Occ3D's layout. Raises a `DatasetFaultError`."""
    channels = list(sequence.channels.values())
    named = [picture_names(sequence, channel) for channel in channels]
    there = [[channel.filename(at) for at in range(len(channel.frames))] for channel in channels]
    places = tar.spans(chain.from_iterable(there))
    lost = np.flatnonzero(places[:, 0] < 0)
    if len(lost):
        name = list(chain.from_iterable(there))[int(lost[0])]
        raise DatasetFaultError("DST-050", DatasetPlace(ANNOTATIONS), f"{quoted(name)} is missing")
    of = tuple(channel.sensor.channel for channel in channels for _ in channel.frames)
    rows = np.full(len(of), -1, np.int64)
    held = tuple(f"{tar.root}{name}" for name in chain.from_iterable(there))
    return SceneSpans(tuple(chain.from_iterable(named)), held, places, of, rows, label_places(tar, sequence))


def label_places(tar: DatasetArchive, sequence: DatasetSequence) -> NDArray[np.int64]:
    """Return the places of each frame's labels; none for a scene without labels. Raises `DST-060`."""
    if not sequence.is_labelled:
        return np.zeros((0, len(PLACE)), np.int64)
    places = tar.spans(sequence.label_name(frame) for frame in range(len(sequence)))
    lost = np.flatnonzero(places[:, 0] < 0)
    if len(lost):
        raise DatasetFaultError("DST-060", DatasetPlace(sequence.label_name(int(lost[0]))), "it is missing")
    return places


def _maps(tar: DatasetArchive, placed: PlacedData) -> Mapping[str, tuple[str, ...]]:
    """Return the map images by log token: each existing file below maps/ once."""
    span = tar.span(placed.tables.file("map"))
    maps = dict[str, dict[str, None]]()
    for _, row in json_rows(span) if span is not None else ():
        name, logs = row.get("filename"), row.get("log_tokens")
        if not isinstance(name, str) or not name.startswith(MAPS) or not NAME.fullmatch(name):
            continue
        if isinstance(logs, list) and tar.span(name) is not None:
            for log in {log_token for log_token in logs if isinstance(log_token, str)} & placed.tables.logs.keys():
                maps.setdefault(log, {})[name] = None
    return {log: tuple(sorted(names)) for log, names in maps.items()}
