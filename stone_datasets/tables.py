"""The tables of the nuScenes schema as columns: every row is read and checked separately.

**Conventions.** Small tables are stored by token, large ones in columns. Row numbers are indices + 1, which is only
valid without faulty rows; the comparison of tables (`links.py`) therefore runs only if there are none.
"""

from collections.abc import Callable, Container, Iterator, Mapping
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from stone.geometry.se3 import SE3
from stone.sensors.calibration import CameraIntrinsics
from stone_base.names import NAME
from stone_datasets.columns import NameColumn, NumberColumn, repeated
from stone_datasets.faults import DatasetFaultError, DatasetFaults, DatasetPlace, quoted
from stone_datasets.files import DatasetFiles
from stone_datasets.json_stream import json_rows
from stone_datasets.rows import FARTHEST_MOUNT_M, FARTHEST_POSE_M, DatasetRow
from stone_datasets.stamps import are_dated, clock_faults, strangers

MODALITIES = ("camera", "lidar", "radar")
# Unused tables: if they exist, only their tokens are compared. Boxes and similar tables are not opened.
OTHERS = ("category", "map")
# Referenced rows, looked up while the rows with references are read.
REFERRED = {"calibrated_sensor": "sensor", "scene": "log", "sample": "scene", "sample_data": "calibrated_sensor"}
WIDEST_PX = 1 << 15
Held = TypeVar("Held")


@dataclass(frozen=True)
class DatasetSensorRow:
    channel: str
    modality: str


@dataclass
class CalibratedSensorRow:
    """`ego_from_sensor`, and a camera's lens once its image size is known."""

    place: int
    row: DatasetRow
    sensor: DatasetSensorRow
    ego_from_sensor: SE3
    size_px: tuple[int, int] | None = None
    lens: CameraIntrinsics | None = None


@dataclass(frozen=True)
class LogRow:
    logfile: str
    vehicle: str
    location: str
    date: str


@dataclass(frozen=True)
class SceneRow:
    place: int
    row: DatasetRow
    name: str
    log: LogRow
    samples: int
    first: str
    last: str


@dataclass
class SampleColumns:
    """`scene` is the scene's position among the scenes; links are hashes of tokens."""

    tokens: list[str] = field(default_factory=list)
    keys: NumberColumn = field(default_factory=lambda: NumberColumn("q"))
    scene: NumberColumn = field(default_factory=lambda: NumberColumn("i"))
    stamp_us: NumberColumn = field(default_factory=lambda: NumberColumn("q"))
    links: NumberColumn = field(default_factory=lambda: NumberColumn("q"))


@dataclass
class PoseColumns:
    """`poses`: seven numbers per row."""

    keys: NumberColumn = field(default_factory=lambda: NumberColumn("q"))
    stamp_us: NumberColumn = field(default_factory=lambda: NumberColumn("q"))
    poses: NumberColumn = field(default_factory=lambda: NumberColumn("d"))


@dataclass
class DatumColumns:
    """`links`: prev, next, frame and pose of a row, as token hashes. `mount`: position among the calibrated sensors."""

    keys: NumberColumn = field(default_factory=lambda: NumberColumn("q"))
    links: NumberColumn = field(default_factory=lambda: NumberColumn("q"))
    mount: NumberColumn = field(default_factory=lambda: NumberColumn("i"))
    stamp_us: NumberColumn = field(default_factory=lambda: NumberColumn("q"))
    is_key: NumberColumn = field(default_factory=lambda: NumberColumn("b"))
    names: NameColumn = field(default_factory=NameColumn)


@dataclass
class DatasetTables:
    """All rows. `mounts` and `scenes` are by token, in table order, which each row's `place` contains.

    `faulty` are tables with faults and the tables that refer to them; missing references to them are not reported
    again.
    """

    version: str
    faulty: set[str] = field(default_factory=set)
    sensors: dict[str, DatasetSensorRow] = field(default_factory=dict)
    mounts: dict[str, CalibratedSensorRow] = field(default_factory=dict)
    logs: dict[str, LogRow] = field(default_factory=dict)
    scenes: dict[str, SceneRow] = field(default_factory=dict)
    samples: SampleColumns = field(default_factory=SampleColumns)
    poses: PoseColumns = field(default_factory=PoseColumns)
    data: DatumColumns = field(default_factory=DatumColumns)

    def file(self, table: str) -> str:
        return f"{self.version}/{table}.json"


Add = Callable[[DatasetTables, DatasetRow], None]


def read_tables(files: DatasetFiles, faults: DatasetFaults) -> DatasetTables:
    """Return every table; faults are added, and rows with faults are left out."""
    tables = DatasetTables(files.version)
    for table, add in READERS.items():
        _read_table(files, tables, (table, add), faults)
    for table in OTHERS:
        if files.span(tables.file(table)) is not None:
            _read_table(files, tables, (table, _unique()), faults)
    if not faults.total:
        _check_clocks(tables, faults)
    return tables


def _read_table(files: DatasetFiles, tables: DatasetTables, what: tuple[str, Add], faults: DatasetFaults) -> None:
    table, add = what
    before = faults.total
    try:
        for row in _rows(files, tables.file(table)):
            try:
                add(tables, row)
            except DatasetFaultError as fault:
                faults.add(fault)
    except DatasetFaultError as fault:
        faults.add(fault)
    for again in _repeated_tokens(tables, table):
        faults.add(again)
    if faults.total > before or REFERRED.get(table) in tables.faulty:
        tables.faulty.add(table)


def _check_clocks(tables: DatasetTables, faults: DatasetFaults) -> None:
    """Check the stamps of each scene's frames, then all data and poses against them."""
    samples, has = tables.samples, dict[bool, bool]()
    stamps_us, scenes = samples.stamp_us.array(np.int64), samples.scene.array(np.int64)
    order = np.argsort(scenes, kind="stable")
    bounds = np.searchsorted(scenes[order], np.arange(len(tables.scenes) + 1)).tolist()
    for scene, start, stop in zip(tables.scenes.values(), bounds[:-1], bounds[1:], strict=True):
        rows = order[start:stop]
        for fault in clock_faults(stamps_us[rows], scene.log.date):
            row = int(rows[fault.at])
            position = DatasetPlace(tables.file("sample"), row + 1, samples.tokens[row])
            faults.add(DatasetFaultError("DST-028", position, fault.what, fault.likely))
        if len(rows):
            has[are_dated(stamps_us[rows])] = True
    for table, column in (("ego_pose", tables.poses.stamp_us), ("sample_data", tables.data.stamp_us)):
        for fault in strangers(
            column.array(np.int64), has_dated=has.get(True, False), has_undated=has.get(False, False)
        ):
            position = DatasetPlace(tables.file(table), fault.at + 1)
            faults.add(DatasetFaultError("DST-028", position, fault.what, fault.likely))


def _rows(files: DatasetFiles, name: str) -> Iterator[DatasetRow]:
    span = files.span(name)
    if span is None:
        raise DatasetFaultError("DST-010", DatasetPlace(name), "it is missing")
    return (DatasetRow(name, number, values) for number, values in json_rows(span))


def _repeated_tokens(tables: DatasetTables, table: str) -> Iterator[DatasetFaultError]:
    """Yield repeated tokens of the large tables, which are compared at the end."""
    columns = {"sample": tables.samples.keys, "ego_pose": tables.poses.keys, "sample_data": tables.data.keys}
    for again, first in repeated(columns[table].array("q")) if table in columns else ():
        token = tables.samples.tokens[again] if table == "sample" else ""
        yield DatasetFaultError(
            "DST-018", DatasetPlace(tables.file(table), again + 1, token), f"row {first + 1} has the same token"
        )


def _unique() -> Add:
    """Return a check that the tokens of a table are unique."""
    seen = set[str]()

    def add(_tables: DatasetTables, row: DatasetRow) -> None:
        seen.add(_new(row, seen))

    return add


def _new(row: DatasetRow, held: Container[str]) -> str:
    token = row.token()
    if token in held:
        raise DatasetFaultError("DST-018", row.place, "an earlier row has the same token")
    return token


def _add_sensor(tables: DatasetTables, row: DatasetRow) -> None:
    token, channel, modality = _new(row, tables.sensors), row.text("channel"), row.text("modality")
    if NAME.fullmatch(channel) is None or modality not in MODALITIES:
        raise DatasetFaultError(
            "DST-016", row.place, f"{quoted(channel)} of modality {quoted(modality)} is not one of {MODALITIES}"
        )
    tables.sensors[token] = DatasetSensorRow(channel, modality)


def _add_mount(tables: DatasetTables, row: DatasetRow) -> None:
    token, sensor = _new(row, tables.mounts), _referred(tables, row, "sensor_token", ("sensor", tables.sensors))
    if sensor is None:
        return
    if sensor.modality == "camera":
        row.lens((1, 1))  # check every camera's matrix, even without images
    tables.mounts[token] = CalibratedSensorRow(len(tables.mounts), row, sensor, row.pose(FARTHEST_MOUNT_M))


def _add_log(tables: DatasetTables, row: DatasetRow) -> None:
    columns = [
        row.text(key) if key in row.values else "" for key in ("logfile", "vehicle", "location", "date_captured")
    ]
    tables.logs[_new(row, tables.logs)] = LogRow(*columns)


def _add_scene(tables: DatasetTables, row: DatasetRow) -> None:
    token, name = _new(row, tables.scenes), row.text("name")
    log = _referred(tables, row, "log_token", ("log", tables.logs))
    if NAME.fullmatch(name) is None:
        raise DatasetFaultError("DST-019", row.place, f"{quoted(name)} is not a valid name")
    ends, count = (row.token("first_sample_token"), row.token("last_sample_token")), row.count("nbr_samples")
    if log is not None:
        tables.scenes[token] = SceneRow(len(tables.scenes), row, name, log, count, *ends)


def _add_sample(tables: DatasetTables, row: DatasetRow) -> None:
    token, stamp_us = row.frame_token(), row.stamp_us()
    links = (hash(row.link("prev")), hash(row.link("next")))
    scene = _referred(tables, row, "scene_token", ("scene", tables.scenes))
    if scene is None:
        return
    samples = tables.samples
    samples.tokens.append(token)
    samples.keys.add(hash(token))
    samples.scene.add(scene.place)
    samples.stamp_us.add(stamp_us)
    samples.links.add(*links)


def _add_pose(tables: DatasetTables, row: DatasetRow) -> None:
    key, numbers = hash(row.token()), row.pose_numbers(FARTHEST_POSE_M)
    tables.poses.stamp_us.add(row.stamp_us())
    tables.poses.keys.add(key)
    tables.poses.poses.extend(numbers)


def _add_datum(tables: DatasetTables, row: DatasetRow) -> None:
    mount = _referred(tables, row, "calibrated_sensor_token", ("calibrated_sensor", tables.mounts))
    keys = [hash(row.link("prev")), hash(row.link("next")), hash(row.token("sample_token"))]
    key, stamp_us, is_key, name = hash(row.token()), row.stamp_us(), row.flag("is_key_frame"), row.text("filename")
    keys.append(hash(row.token("ego_pose_token")))
    if mount is None:
        return
    if mount.sensor.modality == "camera":
        _note_size(mount, row)
    data = tables.data
    data.mount.add(mount.place)
    data.keys.add(key)
    data.links.add(*keys)
    data.stamp_us.add(stamp_us)
    data.is_key.add(is_key)
    data.names.add(name)


def _note_size(mount: CalibratedSensorRow, row: DatasetRow) -> None:
    size = (row.count("width"), row.count("height"))
    if not all(0 < side <= WIDEST_PX for side in size):
        raise DatasetFaultError("DST-027", row.place, f"width and height are {size}; expected 1 to {WIDEST_PX}")
    if mount.size_px is None:
        mount.size_px, mount.lens = size, mount.row.lens(size)
    elif mount.size_px != size:
        raise DatasetFaultError("DST-027", row.place, f"width and height are {size}; earlier: {mount.size_px}")


def _referred(tables: DatasetTables, row: DatasetRow, key: str, to: tuple[str, Mapping[str, Held]]) -> Held | None:
    """Return the referenced row, or None if the other table is faulty. Raises `DST-030`."""
    (table, held), token = to, row.token(key)
    if token not in held and table not in tables.faulty:
        raise DatasetFaultError("DST-030", row.place, f"{key} {quoted(token)} is not a token of {table}")
    return held.get(token)


READERS: Mapping[str, Add] = {
    "sensor": _add_sensor,
    "calibrated_sensor": _add_mount,
    "log": _add_log,
    "scene": _add_scene,
    "sample": _add_sample,
    "ego_pose": _add_pose,
    "sample_data": _add_datum,
}
