"""The tables of a dataset divided by scene: the rows of each scene, in separate files.

    <folder of the scene>/<table>.json   for each table of the schema, and splits.json

**Conventions.** A row is written byte for byte; rows with line ends are written as Python's json does, because exports
have one row per line. Rows keep their order. A scene's files contain its log, its log's maps, the calibrated sensors
and ego poses of its data, and its samples' annotations with their instances. They also contain all sensors, categories,
attributes and visibilities. Rows that belong to no scene are left out, like tables outside the schema. A missing schema
table is written empty.
"""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stone_datasets.build import PlacedData
from stone_datasets.columns import NumberColumn, places_of
from stone_datasets.faults import DatasetPlace
from stone_datasets.files import DatasetFiles
from stone_datasets.json_stream import JsonStream, json_rows
from stone_files.dataset_faults import DatasetFaultError

TABLES = (
    "attribute", "calibrated_sensor", "category", "ego_pose", "log", "map", "sample", "sample_annotation", "instance",
    "sample_data", "scene", "sensor", "visibility",
)  # fmt: skip
SHARED = frozenset({"attribute", "category", "sensor", "visibility"})
SPLITS = "splits.json"
HELD_BYTES = 8 * 2**20
# A row may be written for many scenes; these limits bound the total.
MOST_GROWTH, ALWAYS_BYTES = 4, 256 * 2**20
LINES_AT_ONCE = 1 << 16
encoded = json.JSONEncoder(separators=(",", ":")).encode
Row = Mapping[str, Any]
Scenes = Iterable[int]
FolderOf = Callable[[int], Path]


class SceneTableFiles:
    """Files of tables of `count` scenes; buffers little per scene. `most_bytes` limits the total."""

    def __init__(self, count: int, folder_of: FolderOf, most_bytes: int) -> None:
        self._count, self._folder_of, self._left_bytes = count, folder_of, most_bytes
        self._held: dict[int, list[str]] = {}
        self._held_bytes, self._begun = 0, set[int]()

    def write(self, table: str, rows: Iterable[tuple[Scenes, str]]) -> None:
        """Write the files of one table from its rows as lines, with the scenes of each. Raises `DST-048`."""
        for scenes, line in rows:
            for scene in scenes:
                self._held.setdefault(scene, []).append(line)
                self._held_bytes += len(line)
            if self._held_bytes > HELD_BYTES:
                self._append(table)
        self._append(table)
        for scene in range(self._count):
            with self._open(table, scene) as file:
                file.write("\n]\n" if scene in self._begun else "[\n]\n")
        self._begun.clear()

    def _append(self, table: str) -> None:
        self._left_bytes -= self._held_bytes
        if self._left_bytes < 0:
            raise DatasetFaultError(
                "DST-048", DatasetPlace(f"{table}.json"), f"they would exceed the limit by {-self._left_bytes} bytes"
            )
        for scene, lines in self._held.items():
            with self._open(table, scene) as file:
                file.write((",\n" if scene in self._begun else "[\n") + ",\n".join(lines))
            self._begun.add(scene)
        self._held.clear()
        self._held_bytes = 0

    def _open(self, table: str, scene: int) -> Any:
        return (self._folder_of(scene) / f"{table}.json").open("a", encoding="utf-8")


def write_scene_tables(files: DatasetFiles, placed: PlacedData, folder_of: FolderOf) -> None:
    """Write the tables of each scene into its existing folder. Raises a `DatasetFaultError`."""
    tables = placed.tables
    spans = {table: files.span(tables.file(table)) for table in TABLES}
    size_bytes = sum(span.size_bytes for span in spans.values() if span is not None)
    out = SceneTableFiles(len(tables.scenes), folder_of, MOST_GROWTH * size_bytes + ALWAYS_BYTES)
    owners = _Owners(placed)
    for table in TABLES:
        if (span := spans[table]) is None:
            out.write(table, ())
            continue
        stream = JsonStream(span)
        rows = (row for _, row in json_rows(span, stream))
        out.write(table, ((scenes, _line(row, stream.written)) for scenes, row in owners.of(table, rows)))


def _line(row: Row, written: str) -> str:
    """Return the row on one line, unchanged if it is already `written` on one."""
    return encoded(row) if "\n" in written else written


def write_splits(folder: Path, scene: str, splits: Iterable[str]) -> None:
    """Write the splits that contain the scene."""
    (folder / SPLITS).write_text(json.dumps({split: [scene] for split in splits}, indent=1) + "\n", "utf-8")


class _Owners:
    """Determines the scenes of every table row."""

    def __init__(self, placed: PlacedData) -> None:
        self._placed, self._tables = placed, placed.tables
        self._every = range(len(self._tables.scenes))
        numbers = {token: number for number, token in enumerate(self._tables.logs)}
        named = [scene.row.values["log_token"] for scene in self._tables.scenes.values()]
        logs = [numbers[token] for token in named]
        self._of_log: dict[str, list[int]] = {}
        for number, token in enumerate(named):
            self._of_log.setdefault(token, []).append(number)
        scenes = np.arange(len(logs))
        self._pairs = {
            "log": (np.array(logs, np.int64), scenes),
            "scene": (scenes, scenes),
            "sample": _numbered(self._tables.samples.scene.array(np.int64)),
            "sample_data": _numbered(placed.scene),
            "calibrated_sensor": (placed.mount, placed.scene),
            "ego_pose": (placed.pose, placed.scene),
        }
        keys = self._tables.samples.keys.array(np.int64)
        self._order = np.argsort(keys, kind="stable")
        self._samples = keys[self._order]
        self._instances, self._seen_in = NumberColumn("q"), NumberColumn("q")

    def of(self, table: str, rows: Iterator[Row]) -> Iterator[tuple[Scenes, Row]]:
        if table in SHARED:
            return ((self._every, row) for row in rows)
        if table in self._pairs:
            return zip(_by_row(*self._pairs[table]), rows, strict=False)  # rows without references may follow
        if table == "map":
            return ((self._of_map(row), row) for row in rows)
        if table == "sample_annotation":
            return ((self._of_annotation(row), row) for row in rows)
        return self._of_instances(rows)

    def _of_map(self, row: Row) -> Scenes:
        logs = row.get("log_tokens")
        tokens = {log for log in logs if isinstance(log, str)} if isinstance(logs, list) else set[str]()
        return sorted(scene for token in tokens for scene in self._of_log.get(token, ()))

    def _of_annotation(self, row: Row) -> Scenes:
        at = int(places_of(self._samples, np.array([_hashed(row, "sample_token")]))[0])
        if at < 0:
            return ()
        scene = int(self._pairs["sample"][1][self._order[at]])
        self._instances.add(_hashed(row, "instance_token"))
        self._seen_in.add(scene)
        return (scene,)

    def _of_instances(self, rows: Iterator[Row]) -> Iterator[tuple[Scenes, Row]]:
        """Yield instances with their scenes; annotations must have been processed before."""
        keys, scenes = self._instances.array(np.int64), self._seen_in.array(np.int64)
        pairs = np.unique(np.stack([keys, scenes]), axis=1) if len(keys) else np.zeros((2, 0), np.int64)
        for row in rows:
            key = _hashed(row, "token")
            start, stop = np.searchsorted(pairs[0], key, "left"), np.searchsorted(pairs[0], key, "right")
            yield pairs[1][start:stop].tolist(), row


def _hashed(row: Row, key: str) -> int:
    """Return the hash of the row's token, or 0 if it has none."""
    token = row.get(key)
    return hash(token) if isinstance(token, str) else 0


def _numbered(scenes: NDArray[np.integer]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    return np.arange(len(scenes)), scenes.astype(np.int64, copy=False)


def _by_row(rows: NDArray[np.int64], scenes: NDArray[np.int64]) -> Iterator[Scenes]:
    """Yield the scenes of row 0, 1, … without repeats, up to the last row with a scene."""
    order = np.lexsort((scenes, rows))
    rows, scenes = rows[order], scenes[order]
    is_first = np.append(True, (np.diff(rows) != 0) | (np.diff(scenes) != 0))[: len(rows)]
    rows, scenes = rows[is_first], scenes[is_first]
    ends = np.cumsum(np.bincount(rows)) if len(rows) else rows
    begin = 0
    for first in range(0, len(ends), LINES_AT_ONCE):
        for end in ends[first : first + LINES_AT_ONCE].tolist():
            yield scenes[begin:end].tolist()
            begin = end
