"""sensor_msgs/msg/PointCloud2 of a radar: points with a speed, a cross section, or both.

**Conventions.** The points of the message are kept unchanged; angles and range are computed from them if the driver
gives none. Names differ by driver (ars548_ros: v, RCS; Nebula: range_rate, rcs), so the lookup ignores case. Points
that are not finite stay, as invalid. Source: ars548_ros, Nebula, ti_mmwave and Smartmicro drivers.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stone_recordings.bags.errors import CloudLayoutError
from stone_recordings.messages.batch import StampedMessage
from stone_recordings.messages.pointcloud2 import decode_cloud
from stone_recordings.messages.radars.detections import COLUMNS, RadarDetections, offsets_of
from stone_recordings.messages.types.table import as_doubles

TYPE = "sensor_msgs/msg/PointCloud2"
Plain = Callable[[memoryview], memoryview]
NAMES = {
    "azimuth": ("azimuth", "azimuth_angle"),
    "elevation": ("elevation", "elevation_angle"),
    "range": ("range",),
    "range_rate": ("range_rate", "v", "v_r", "doppler", "velocity", "radial_speed", "doppler_velocity"),
    "rcs": ("rcs", "amplitude", "power"),
}


def decode_radar_cloud(messages: Iterable[StampedMessage], plain: Plain = memoryview) -> RadarDetections:
    """Decode N messages; range rate and cross section are NaN if the driver gives none. `plain` unpacks a message.

    Raises: MessageLayoutError, ByteOrderError, CloudLayoutError.
    """
    clouds = [decode_cloud(plain(message.payload)) for message in messages]
    points = [_points(cloud.points) for cloud in clouds]
    with np.errstate(over="ignore", invalid="ignore"):  # values too large for a float32 become infinite
        parts = [_columns(cloud.points, xyz) for cloud, xyz in zip(clouds, points, strict=True)]
        columns = {name: _joined([part[name] for part in parts]).astype(np.float32) for name in COLUMNS}
    given = np.concatenate([np.empty((0, 3)), *points])
    return RadarDetections(
        np.array([cloud.stamp_ns for cloud in clouds], np.int64),
        offsets_of(np.array([len(xyz) for xyz in points], np.int64)),
        columns["azimuth"],
        columns["elevation"],
        columns["range"],
        columns["range_rate"],
        columns["rcs"],
        np.isfinite(given).all(axis=1),
        None,
        given,
    )


def _points(records: NDArray[np.void]) -> NDArray[np.float64]:
    names = records.dtype.names or ()
    if not all(name in names and records.dtype[name].kind == "f" for name in "xyz"):
        raise CloudLayoutError(f"x, y and z must be floats, its fields are {', '.join(names)}"[:200])
    return np.stack([as_doubles(records[name]) for name in "xyz"], axis=1)


def _columns(records: NDArray[np.void], xyz: NDArray[np.float64]) -> dict[str, NDArray[Any]]:
    by_name = {name.lower(): name for name in reversed(records.dtype.names or ())}
    flat = np.hypot(xyz[:, 0], xyz[:, 1])
    columns = {
        "azimuth": np.arctan2(xyz[:, 1], xyz[:, 0]),
        "elevation": np.arctan2(xyz[:, 2], flat),
        "range": np.hypot(flat, xyz[:, 2]),
        "range_rate": np.full(len(xyz), np.nan),
        "rcs": np.full(len(xyz), np.nan),
    }
    for ours, theirs in NAMES.items():
        field = next((by_name[name] for name in theirs if name in by_name), None)
        if field is not None and records.dtype[field].kind in "fiu":
            columns[ours] = records[field]
    return columns


def _joined(parts: Sequence[NDArray[Any]]) -> NDArray[Any]:
    return np.concatenate([np.empty(0, np.float64), *parts])
