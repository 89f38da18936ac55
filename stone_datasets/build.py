"""Builds the index from valid tables: compares links, assigns data to frames, and checks the requirements of sequences.

**Conventions.** As in `stone_datasets/links.py`: whole columns are compared.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone.geometry.se3 import SE3
from stone_datasets.causes import folder_cause
from stone_datasets.columns import Keys, repeated, rows_of
from stone_datasets.faults import DatasetFaultError, DatasetFaults, DatasetPlace, quoted
from stone_datasets.index import DatasetChannel
from stone_datasets.links import LinkedRows, Places, check_chains, check_scenes
from stone_datasets.tables import CalibratedSensorRow, DatasetTables
from stone_exports.frames import LIDAR_CHANNEL, ExportedSensor
from stone_files.dataset_layout import is_inside, path_fault

FARTHEST_US, NS_PER_US = 1_000_000, 1000
FOLDERS = ("samples", "sweeps")
DIGITS = re.compile(r"[0-9]{10,19}")


@dataclass(frozen=True, eq=False)
class PlacedData:
    """The columns of sample_data with resolved references: rows of samples and poses, scene, channel and position.

    `at` is the position of a row's frame within its scene, by stamp.
    """

    tables: DatasetTables
    mounts: Sequence[CalibratedSensorRow]
    mount: Places
    frame: Places
    pose: Places
    scene: Places
    at: Places
    channel: Places
    stamps_us: NDArray[np.int64]
    is_key: NDArray[np.bool_]

    def place(self, row: int) -> DatasetPlace:
        return DatasetPlace(self.tables.file("sample_data"), row + 1)

    def name(self, row: int) -> str:
        return self.tables.data.names[row]

    def sensor(self, row: int) -> CalibratedSensorRow:
        return self.mounts[int(self.mount[row])]


@dataclass(frozen=True, eq=False)
class DatasetFrames:
    """All samples sorted by scene and stamp: `order` (N,) are their rows, `starts` (S + 1,) the start of each scene."""

    order: Places
    starts: Places
    stamps_ns: NDArray[np.int64]


def frames_of(tables: DatasetTables, faults: DatasetFaults) -> DatasetFrames:
    """Return the samples after checks of their chains and scenes."""
    held = tables.samples
    previous, following = _links(held.links.array(np.int64), 2)
    stamps_us, scenes = held.stamp_us.array(np.int64), held.scene.array(np.int64)
    samples = LinkedRows(
        tables.file("sample"), held.keys.array(np.int64), previous, following, stamps_us, scenes, held.tokens
    )
    before = faults.total
    check_chains(samples, faults)
    if faults.total == before:
        check_scenes(tables, samples, faults)
    counts = np.bincount(samples.group, minlength=len(tables.scenes))
    starts = np.concatenate([[0], np.cumsum(counts)])
    order = np.lexsort((samples.stamps, samples.group))
    return DatasetFrames(order, starts, samples.stamps[order] * NS_PER_US)


def data_of(tables: DatasetTables, frames: DatasetFrames, faults: DatasetFaults) -> PlacedData | None:
    """Return the checked data, or None if a reference cannot be resolved."""
    data, before = tables.data, faults.total
    previous, following, frame_keys, pose_keys = _links(data.links.array(np.int64), 4)
    keys = data.keys.array(np.int64)
    frame = rows_of(tables.samples.keys.array(np.int64), frame_keys)
    pose = rows_of(tables.poses.keys.array(np.int64), pose_keys)
    for lost in _dangling(tables, {"sample": frame, "ego_pose": pose}):
        faults.add(lost)
    if faults.total > before:
        return None
    mounts = list(tables.mounts.values())
    channels = sorted({mount.sensor.channel for mount in mounts})
    channel_of = np.array([channels.index(mount.sensor.channel) for mount in mounts], np.int64)
    mount, scenes = data.mount.array(np.int64), tables.samples.scene.array(np.int64)
    at = np.empty(len(frames.order), np.int64)
    at[frames.order] = np.arange(len(frames.order)) - frames.starts[scenes[frames.order]]
    facts = (frame, pose, scenes[frame], at[frame], channel_of[mount], data.stamp_us.array(np.int64))
    placed = PlacedData(tables, mounts, mount, *facts, data.is_key.array(np.bool_))
    group = placed.scene * len(channels) + placed.channel
    check_chains(LinkedRows(tables.file("sample_data"), keys, previous, following, facts[-1], group), faults)
    for faults_of_kind in (
        _misnamed(placed),
        _wrong_frames(placed, frames),
        _without_sweep(placed, frames),
        _changing(placed),
    ):
        for fault in faults_of_kind:
            faults.add(fault)
    return placed


def channels_of(placed: PlacedData) -> Iterator[Mapping[str, DatasetChannel]]:
    """Yield the channels of each scene by name."""
    poses = placed.tables.poses.poses.array(np.float64).reshape(-1, 7)
    rows = np.flatnonzero(placed.is_key)
    rows = rows[np.lexsort((placed.at[rows], placed.channel[rows], placed.scene[rows]))]
    bounds = np.searchsorted(placed.scene[rows], np.arange(len(placed.tables.scenes) + 1))
    for start, stop in zip(bounds[:-1].tolist(), bounds[1:].tolist(), strict=True):
        own = rows[start:stop]
        cuts = np.flatnonzero(np.diff(placed.channel[own])) + 1
        parts = [part for part in np.split(own, cuts) if len(part)]
        channels = [_channel(placed, part, poses) for part in parts]
        yield {channel.sensor.channel: channel for channel in channels}


def _channel(placed: PlacedData, rows: Places, poses: NDArray[np.float64]) -> DatasetChannel:
    mount = placed.sensor(int(rows[0]))
    sensor = ExportedSensor(mount.sensor.channel, mount.sensor.modality, mount.ego_from_sensor, mount.lens)
    stamps_ns = placed.stamps_us[rows] * NS_PER_US
    return DatasetChannel(
        sensor, placed.at[rows], stamps_ns, SE3(poses[placed.pose[rows]]), rows, placed.tables.data.names
    )


def channel_and_stamp(name: str) -> tuple[str, int] | None:
    """Return sensor and microseconds from a file name `…__<CHANNEL>__<µs>.<ending>`, or None for other names."""
    parts = name.rpartition("/")[2].rsplit("__", 2)
    digits = parts[-1].partition(".")[0]
    return (parts[1], int(digits)) if len(parts) == 3 and DIGITS.fullmatch(digits) else None


def _links(held: Keys, count: int) -> tuple[Keys, ...]:
    return tuple(np.ascontiguousarray(column) for column in held.reshape(-1, count).T)


def _dangling(tables: DatasetTables, rows_by_table: Mapping[str, Places]) -> Iterator[DatasetFaultError]:
    for table, rows in rows_by_table.items():
        for row in np.flatnonzero(rows < 0).tolist():
            position = DatasetPlace(tables.file("sample_data"), row + 1)
            what = f"the {table}_token of {quoted(tables.data.names[row])} is not a token of {table}"
            yield DatasetFaultError("DST-030", position, what)


def _misnamed(placed: PlacedData) -> Iterator[DatasetFaultError]:
    """Yield files in a wrong folder, with another sensor or stamp than their row, or with two rows."""
    names = placed.tables.data.names
    are_sound = True
    for row in range(len(names)):
        fault = _fault_of_name(placed, row, names[row])
        if fault is not None:
            are_sound = False
            yield fault
    if not are_sound:
        return
    for again, first in repeated(np.array([hash(names[row]) for row in range(len(names))], np.int64)):
        yield DatasetFaultError(
            "DST-042", placed.place(again), f"row {first + 1} also refers to {quoted(names[again])}"
        )


def _fault_of_name(placed: PlacedData, row: int, name: str) -> DatasetFaultError | None:
    channel, (folder, _, base) = placed.sensor(row).sensor.channel, name.rpartition("/")
    name_parts = channel_and_stamp(base) or (channel, int(placed.stamps_us[row]))
    if not is_inside(name):
        return path_fault("filename", name, placed.place(row), table="sample_data")
    if not base or folder not in [f"{prefix}/{channel}" for prefix in FOLDERS] or name_parts[0] != channel:
        likely = folder_cause(name, [f"{prefix}/{channel}/" for prefix in FOLDERS])
        what = f"filename is {quoted(name)}, but the sensor is {channel}"
        return DatasetFaultError("DST-041", placed.place(row), what, likely)
    if name_parts[1] != placed.stamps_us[row]:
        return DatasetFaultError(
            "DST-040", placed.place(row), f"filename is {quoted(name)}, but timestamp is {placed.stamps_us[row]}"
        )
    return None


def _wrong_frames(placed: PlacedData, frames: DatasetFrames) -> Iterator[DatasetFaultError]:
    """Yield key-frame data that are far from their frame, or a second datum of the same sensor in a frame."""
    stamps_us = np.empty(len(frames.order), np.int64)
    stamps_us[frames.order] = frames.stamps_ns // NS_PER_US
    away_us = placed.stamps_us - stamps_us[placed.frame]
    for row in np.flatnonzero(placed.is_key & (np.abs(away_us) > FARTHEST_US)).tolist():
        yield DatasetFaultError(
            "DST-039", placed.place(row), f"{quoted(placed.name(row))} is {away_us[row] / 1e6:.1f} s from it"
        )
    keys = np.flatnonzero(placed.is_key)
    for again, first in repeated(placed.frame[keys] * (placed.channel.max(initial=0) + 1) + placed.channel[keys]):
        row, other = int(keys[again]), int(keys[first])
        yield DatasetFaultError(
            "DST-037", placed.place(row), f"row {other + 1} has the same sensor {placed.sensor(row).sensor.channel}"
        )


def _without_sweep(placed: PlacedData, frames: DatasetFrames) -> Iterator[DatasetFaultError]:
    tables = placed.tables
    is_lidar = np.array([mount.sensor.channel == LIDAR_CHANNEL for mount in placed.mounts], np.bool_)
    with_sweep = placed.frame[placed.is_key & is_lidar[placed.mount]]
    for row in np.setdiff1d(frames.order, with_sweep).tolist():
        position = DatasetPlace(tables.file("sample"), row + 1, tables.samples.tokens[row])
        yield DatasetFaultError("DST-036", position, f"it has no key frame of {LIDAR_CHANNEL}")


def _changing(placed: PlacedData) -> Iterator[DatasetFaultError]:
    """Yield the first row of a second calibration of a scene and sensor."""
    chains = placed.scene * (placed.channel.max(initial=0) + 1) + placed.channel
    pairs, firsts = np.unique(np.stack([chains, placed.mount]), axis=1, return_index=True)
    for again, first in repeated(pairs[0]):
        row, other = int(firsts[again]), int(firsts[first])
        tokens = [placed.sensor(datum).row.place.token for datum in (row, other)]
        yield DatasetFaultError("DST-038", placed.place(row), f"{tokens[0]} here, {tokens[1]} in row {other + 1}")
