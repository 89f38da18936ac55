"""LiDAR sweeps in nuScenes-layout exports, with or without labels: found by frame token, read separately.

**Conventions.** `ego_from_lidar` comes from `calibrated_sensor`. Exports are not trusted: rows are checked, sizes
bounded.
"""

from collections.abc import Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone.geometry.se3 import SE3
from stone_exports.files import ExportContent, Files
from stone_exports.tables import poses_in, row_pose, stamp_of, table_rows, table_span
from stone_files.dataset_layouts import plain_token

CHANNEL = "LIDAR_TOP"
COLUMNS = 5  # x y z intensity ring
MOST_SWEEP_BYTES = 256 * 2**20
FARTHEST_M, FARTHEST_RETURN_M = 100.0, 1e5


@dataclass(frozen=True, eq=False)
class SweepFile:
    """The file of a sweep, and the sensor's mount."""

    span: ExportContent
    ego_from_lidar: SE3

    def points_ego(self) -> NDArray[np.float32]:
        """Return points (N, 3) in the ego frame, without implausible positions. Raises `DamagedExportError`."""
        return self.returns_ego()[:, :3]

    def returns_ego(self) -> NDArray[np.float32]:
        """Return rows (N, 4): x y z in the ego frame in metres, and the measured intensity, or 0 if it is not finite.

        Implausible positions are left out. Raises `DamagedExportError`.
        """
        content = self.span.read(MOST_SWEEP_BYTES)
        if len(content) % (COLUMNS * 4):
            raise self.span.damaged(f"its {len(content)} bytes are not rows of {COLUMNS} float32 values")
        rows = np.frombuffer(content, "<f4").reshape(-1, COLUMNS)
        rows = rows[(np.abs(rows[:, :3]) < FARTHEST_RETURN_M).all(axis=1)]
        returns = np.empty((len(rows), 4), np.float32)
        returns[:, :3] = self.ego_from_lidar @ rows[:, :3].astype(np.float64)
        returns[:, 3] = np.where(np.isfinite(rows[:, 3]), rows[:, 3], 0)
        return returns


@dataclass(frozen=True, eq=False)
class PlacedSweep(SweepFile):
    """A sweep with its time and the robot's pose."""

    stamp_us: int
    global_from_ego: SE3


def sweeps_in(files: Files, tokens: AbstractSet[str]) -> dict[str, PlacedSweep]:
    """Return the sweeps of the frames in `tokens` that the export contains. Raises `DamagedExportError`."""
    mounts, poses = _mounts(files), poses_in(files)
    sweeps = dict[str, PlacedSweep]()
    for row in table_rows(files, "sample_data"):
        mount = mounts.get(str(row.get("calibrated_sensor_token")))
        token = plain_token(str(row.get("sample_token")))
        if mount is None or token not in tokens or row.get("is_key_frame") is not True:
            continue
        filename = str(row.get("filename"))
        span = files.span(filename)
        if span is None:
            raise table_span(files, "sample_data").damaged(f"it names {filename[:200]!r}, which is missing")
        pose = poses.get(str(row.get("ego_pose_token")))
        if pose is None:
            raise table_span(files, "sample_data").damaged(f"{filename[:200]!r} has no pose")
        sweeps[str(token)] = PlacedSweep(span, mount, stamp_of(files, "sample_data", row), pose)
    return sweeps


def _mounts(files: Files) -> Mapping[str, SE3]:
    """Return `ego_from_lidar` by calibrated sensor token."""
    sensors = {str(row.get("token")) for row in table_rows(files, "sensor") if row.get("channel") == CHANNEL}
    rows = (row for row in table_rows(files, "calibrated_sensor") if row.get("sensor_token") in sensors)
    return {str(row.get("token")): row_pose(files, "calibrated_sensor", row, FARTHEST_M) for row in rows}
