"""Edits of clouds, as caused by drivers, networks and disks.

**Conventions.** As in `testing.worlds.faults.edits`.
"""

from typing import Any

import numpy as np

from testing.worlds.faults.edits import points_of
from testing.worlds.faults.fault import Edit


def declared(**said: int) -> Edit:
    """Replace numbers in its head."""

    def edit(message: Any) -> Any:
        for name, value in said.items():
            setattr(message, name, value)
        return message

    return edit


def emptied_cloud(message: Any) -> Any:
    message.width = message.row_step = 0
    message.data = message.data[:0]
    return message


def with_points(value: float, share: float = 1.0) -> Edit:
    """Set all three coordinates of a share of its points to this value."""

    def edit(message: Any) -> Any:
        points = points_of(message)
        points[np.random.default_rng(3).random(len(points)) < share] = value
        return message

    return edit


def without_z(message: Any) -> Any:
    message.fields[2].name = "_"
    return message


def of_xyz_alone(message: Any) -> Any:
    """Use another layout: packed, 12 bytes per point."""
    points = points_of(message).copy()
    message.fields = message.fields[:3]
    message.point_step, message.height = 12, 1
    message.width, message.row_step = len(points), 12 * len(points)
    message.data = np.frombuffer(points.tobytes(), np.uint8)
    return message


def of_another_sensor(message: Any) -> Any:
    """Move it to a frame of its own, turned by a right angle and 3 m higher."""
    message.header.frame_id = "lidar_rear"
    points = points_of(message)
    points[:] = points[:, [1, 0, 2]] * np.array([-1.0, 1.0, 1.0], np.float32) + np.array([0, 0, 3.0], np.float32)
    return message


def big_endian_cloud(message: Any) -> Any:
    message.is_bigendian = True
    message.data = message.data.reshape(-1, 4)[:, ::-1].reshape(-1) if message.point_step % 4 == 0 else message.data
    return message


def with_times(value: float) -> Edit:
    """Set all its point times, if it has any, to one time of another clock."""

    def edit(message: Any) -> Any:
        at = next((field.offset for field in message.fields if field.name in ("timestamp", "time", "t")), None)
        if at is not None:
            message.data = message.data.copy()
            count = message.width * message.height
            np.ndarray((count,), "<f8", message.data.data, at, (message.point_step,))[:] += value
        return message

    return edit
