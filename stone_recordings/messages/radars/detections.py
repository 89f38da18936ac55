"""Radar detections of many scans in one table, cut by offsets: the result of decoding any radar message.

**Conventions.** The radar's axes are x forward (boresight), y left, z up; azimuth is positive to the left, elevation
upwards. Range rate is positive if the target moves away. A detection that the sensor itself marks as invalid stays in
the table with `is_valid` False: nothing is dropped. Source: ARS 548 RDI interface, REP 103.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stone_recordings.bags.errors import MessageLayoutError
from stone_recordings.messages.types.cdr import NS_PER_S
from stone_recordings.messages.types.table import MessageTable, as_doubles

# The flag bits of one detection, ARS 548: distance, azimuth, elevation and range rate (the others are deviations).
INVALID_MASK = 0x01 | 0x04 | 0x10 | 0x40

COLUMNS = ("azimuth", "elevation", "range", "range_rate", "rcs")


@dataclass(frozen=True, eq=False)
class RadarDetections:
    """M detections of N scans; scan i has the rows `offsets[i]:offsets[i + 1]`.

    `stamps_ns` (N,) are header stamps; `sensor_stamps_ns` (N,) the radar's own clock, None if the message has none. All
    other columns are (M,), or (M, 3) if the message contains `given_points`; NaN if a type lacks the value.
    """

    stamps_ns: NDArray[np.int64]
    offsets: NDArray[np.int64]
    azimuth_rad: NDArray[np.float32]
    elevation_rad: NDArray[np.float32]
    range_m: NDArray[np.float32]
    range_rate_m_s: NDArray[np.float32]
    rcs_db: NDArray[np.float32]
    is_valid: NDArray[np.bool_]
    sensor_stamps_ns: NDArray[np.int64] | None = None
    given_points: NDArray[np.float64] | None = None

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @property
    def counts(self) -> NDArray[np.int64]:
        """The detections of each scan (N,)."""
        return np.diff(self.offsets)

    @cached_property
    def points_radar(self) -> NDArray[np.float64]:
        """The points (M, 3), metres in the radar's axes, computed on first use."""
        if self.given_points is not None:
            return self.given_points
        azimuth, elevation = as_doubles(self.azimuth_rad), as_doubles(self.elevation_rad)
        with np.errstate(invalid="ignore"):  # an infinite angle has no direction: NaN, and is not valid
            level = np.cos(elevation)
            directions = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], axis=1)
            return np.asarray(directions * as_doubles(self.range_m)[:, None], np.float64)

    def of(self, scan: int) -> "RadarDetections":
        """Return one scan, as a table of N = 1. Raises IndexError beyond the last."""
        index = range(len(self))[scan]
        rows = slice(int(self.offsets[index]), int(self.offsets[index + 1]))
        own = None if self.sensor_stamps_ns is None else self.sensor_stamps_ns[index : index + 1]
        return RadarDetections(
            self.stamps_ns[index : index + 1],
            np.array([0, rows.stop - rows.start], np.int64),
            self.azimuth_rad[rows],
            self.elevation_rad[rows],
            self.range_m[rows],
            self.range_rate_m_s[rows],
            self.rcs_db[rows],
            self.is_valid[rows],
            own,
            None if self.given_points is None else self.given_points[rows],
        )


def detections(
    stamps_ns: NDArray[np.int64],
    offsets: NDArray[np.int64],
    columns: Mapping[str, NDArray[Any]],
    sensor_stamps_ns: NDArray[np.int64] | None = None,
) -> RadarDetections:
    """Return the table from columns azimuth, elevation, range, range_rate, rcs and invalid (bool).

    A value that is not finite is invalid, whatever the sensor reports.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # values too large for a float32 become infinite
        read = {name: np.ascontiguousarray(columns[name], np.float32) for name in COLUMNS}
    is_finite = np.ones(len(read["range"]), np.bool_)
    for name in COLUMNS[:4]:
        is_finite &= np.isfinite(read[name])
    return RadarDetections(
        stamps_ns,
        offsets,
        read["azimuth"],
        read["elevation"],
        read["range"],
        read["range_rate"],
        read["rcs"],
        is_finite & ~np.asarray(columns["invalid"], np.bool_),
        sensor_stamps_ns,
    )


def from_sequence(
    table: MessageTable, sequence: str, names: Mapping[str, str], flags: Sequence[str] = ()
) -> RadarDetections:
    """Return the table from a sequence of detections: `names` are its fields for the columns, `flags` its invalid
    flags.

    Raises: MessageLayoutError if the definition gives them other types.
    """
    read = {name: table.ragged(f"{sequence}.{name}") for name in (*names.values(), *flags)}
    offsets = next(iter(read.values()))[0]
    for name, (own, _values) in read.items():
        if not np.array_equal(own, offsets):
            raise MessageLayoutError(table.type_name, f"{sequence}.{name} is not as long as the other columns")
    columns = {ours: read[theirs][1] for ours, theirs in names.items()}
    columns["invalid"] = np.zeros(offsets[-1], np.bool_)
    for name in flags:
        columns["invalid"] |= read[name][1] != 0
    return detections(table.stamps_ns(), offsets, columns)


def joined(parts: Sequence[RadarDetections]) -> RadarDetections:
    """Return several tables of the same kind as one; there is at least one."""
    if len(parts) == 1:
        return parts[0]
    columns = [_columns(part) for part in parts]
    offsets = offsets_of(np.concatenate([part.counts for part in parts]))
    return RadarDetections(
        offsets=offsets, **{name: np.concatenate([part[name] for part in columns]) for name in columns[0]}
    )


def _columns(part: RadarDetections) -> dict[str, NDArray[Any]]:
    read = {item.name: getattr(part, item.name) for item in fields(part)}
    return {name: value for name, value in read.items() if value is not None and name != "offsets"}


def offsets_of(counts: NDArray[np.integer]) -> NDArray[np.int64]:
    """Return the offsets (N + 1,) of N scans from their counts (N,): the start of each scan, and the total."""
    return np.concatenate([[0], np.cumsum(counts, dtype=np.int64)]).astype(np.int64)


def joined_ns(seconds: NDArray[np.integer], nanoseconds: NDArray[np.integer]) -> NDArray[np.int64]:
    return np.asarray(seconds.astype(np.int64) * NS_PER_S + nanoseconds.astype(np.int64), np.int64)
