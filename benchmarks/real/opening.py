"""Opening of a description's data as a sequence, whole or in part: a recording by its poses, a scan by its track."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.real.description import Described
from benchmarks.real.errors import DescriptionError
from services.ingest.pipeline import SynchroniseOptions
from services.ingest.sequence import open_sequence
from stone.geometry.se3 import SE3, Array
from stone.geometry.trajectory import Trajectory
from stone.sensors.sequence import Frames, Sequence, Sweep, SweepSource, frame_token
from stone_recordings.calibrations.file import read_calibration

PERIOD_NS = 100_000_000
POINT_BYTES = 16


@dataclass(frozen=True, eq=False)
class ScanSweeps:
    """A SweepSource of one scan."""

    points_lidar: NDArray[np.float32]

    def sweep(self, index: int) -> Sweep:
        """Return the scan, of the only frame."""
        return Sweep(index, self.points_lidar)


@dataclass(frozen=True, eq=False)
class ChosenSweeps:
    """Some sweeps of a source: those of the frames `rows`."""

    source: SweepSource
    rows: NDArray[np.int64]

    def sweep(self, index: int) -> Sweep:
        """Return the sweep of the index-th of the chosen frames."""
        return self.source.sweep(int(self.rows[index]))


@dataclass(frozen=True, eq=False)
class ThinnedSweeps:
    """Sweeps reduced to one band of elevation in `every`, each as wide as the ring spacing.

    Unevenly spaced rings may share a band, so the result has about that share of the rings.
    """

    source: SweepSource
    every: int
    spacing_deg: float

    def sweep(self, index: int) -> Sweep:
        """Return the sweep with the points of the remaining bands."""
        whole = self.source.sweep(index)
        x, y, z = whole.points_lidar.T
        band = np.floor(np.rad2deg(np.arctan2(z, np.hypot(x, y))) / self.spacing_deg).astype(np.int64)
        return replace(whole, points_lidar=whole.points_lidar[band % self.every == 0])


def opened(described: Described, options: SynchroniseOptions, track: str | None = None) -> tuple[Sequence, SweepSource]:
    """Return the sequence and its sweeps; for a scan with the declared path `track`, or with only its own position.

    Raises `DescriptionError` and what `open_sequence` raises.
    """
    description = described.description
    calibration = described.file(description.calibration)
    if description.recording is not None:
        return open_sequence(described.source, calibration, description.name, options)
    rig, findings = read_calibration(calibration)
    way = along(np.array(description.tracks_m[track] if track else [(0.0, 0.0)]))
    frames = Frames(way.stamps_ns[:1], (frame_token(description.name, 0),), way.map_from_ego[:1])
    sequence = Sequence(description.name, frames, (), rig, "stated", findings=findings, track=way)
    points = _rows_of(described.source)
    return sequence, ScanSweeps(points[_is_return(points)])


def along(corners: Array) -> Trajectory:
    """Return level poses at the corners (P, 2), turning at each to the next; the first faces ahead, like the scan."""
    ways = np.diff(corners, axis=0)
    headings = np.concatenate([[0.0], np.repeat(np.arctan2(ways[:, 1], ways[:, 0]), 2)])
    places = np.repeat(corners, 2, axis=0)[: len(headings)]
    nothing = np.zeros(len(headings))
    wxyz = np.column_stack([np.cos(headings / 2), nothing, nothing, np.sin(headings / 2)])
    poses = SE3.from_parts(wxyz, np.column_stack([places, nothing]))
    return Trajectory(np.arange(len(headings)) * PERIOD_NS, poses)


def classes_of(described: Described, points: str, labels: str) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Return points (N, 3) of a labelled scan and their classes (N,). Raises `DescriptionError` if lengths differ."""
    xyz, path = _rows_of(described.file(points)), described.file(labels)
    if not path.is_file():
        raise DescriptionError(described.path, f"{path} does not exist")
    kinds = np.fromfile(path, "<u4").astype(np.int64) & 0xFFFF
    if len(kinds) != len(xyz):
        raise DescriptionError(described.path, f"{labels} has {len(kinds)} classes for {len(xyz)} points")
    is_return = _is_return(xyz)
    return xyz[is_return], kinds[is_return]


def part_of(sequence: Sequence, sweeps: SweepSource, rows: NDArray[np.int64]) -> tuple[Sequence, SweepSource]:
    """Return the same run with these frames only; its track stays whole."""
    frames = sequence.frames
    tokens = tuple(frames.tokens[row] for row in rows.tolist())
    chosen = Frames(frames.stamps_ns[rows], tokens, frames.map_from_ego[rows])
    return replace(sequence, frames=chosen), ChosenSweeps(sweeps, rows)


def _rows_of(path: Path) -> NDArray[np.float32]:
    if not path.is_file():
        raise DescriptionError(path, "does not exist")
    size = path.stat().st_size
    if size == 0 or size % POINT_BYTES:
        raise DescriptionError(path, f"has {size} bytes, not a multiple of {POINT_BYTES} (x, y, z, intensity)")
    rows: NDArray[np.float32] = np.fromfile(path, "<f4").reshape(-1, 4)[:, :3].astype(np.float32)
    if not np.isfinite(rows).all():
        raise DescriptionError(path, "contains a coordinate that is not finite")
    return rows


def _is_return(points: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return which rows (N, 3) are returns; foreign scans have rows of zeros for missing returns."""
    return np.asarray((points != 0).any(axis=1))
