"""Compiled kernels and libraries for reading recordings, loaded once in the process that forks children.

**Conventions.** Numba compiles for the type, the alignment and the mutability of columns, so the kernels are called
with each known driver's point layout as decoded from a message. Other layouts are compiled at their first use, a second
each time. Lazily imported libraries are used here too; otherwise each child would import them again.
"""

from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from stone.geometry.placed_points import placed
from stone.geometry.se3 import SE3
from stone.geometry.trajectory import Trajectory
from stone.sensors.deskew import SweepMount, deskew
from stone.sensors.ground_links import Way, drift, links_between, look
from stone.sensors.ground_points import plane_around
from stone.sensors.selection import world_points
from stone_recordings.messages.lidar import resolve_points
from stone_recordings.messages.types.registry import registry
from stone_recordings.report.quality.plots import Frame, time_plot
from stone_recordings.sync.registration import Target


class PointLayout(NamedTuple):
    """Name, type and byte offset of a point's time and of its laser, and the size of a point in bytes."""

    time: tuple[str, str, int]
    laser: tuple[str, str, int]
    point_bytes: int


HESAI = PointLayout(("timestamp", "<f8", 18), ("ring", "<u2", 16), 26)
NEBULA = PointLayout(("time_stamp", "<u4", 28), ("channel", "<u2", 14), 32)
OUSTER = PointLayout(("t", "<u4", 20), ("ring", "u1", 26), 48)


@cache
def warm() -> None:
    """Call each kernel with four points, and the ground kernels with a plain around the robot, once per process."""
    _use_kernels()
    _use_libraries()


def _use_kernels() -> None:
    plain = _plain()
    plane_around(world_points(plain, SE3.identity(), (), 1.0))
    look(placed(SE3.identity(), plain.astype(np.float64)))
    still = Trajectory(np.array([0, 10**9]), SE3.identity((2,)))
    mount = SweepMount(still, SE3.identity(), 10**9)
    for layout in (HESAI, NEBULA, OUSTER):
        points = resolve_points(_points(layout), 0)
        if points.offset_ns is not None:
            deskew(points.points_lidar, points.offset_ns, mount, 10**8)


def _use_libraries() -> None:
    """Use scipy's trees and sparse matrices, small_gicp, all known message types, matplotlib and image formats."""
    plain = _plain().astype(np.float64)
    seen, row = look(plain), np.arange(2)
    way = Way(np.stack([row, row], axis=1).astype(np.float64), row.astype(np.float64), 0 * row)
    drift(links_between((seen, seen), way), way, 1.0)
    Target(plain, 1.0)
    registry()
    time_plot(Frame("warmup", 1.0, ""), ())
    Image.preinit()


def _plain() -> NDArray[np.float32]:
    """Return level ground (N, 3) around the origin."""
    side_m = np.arange(-3.0, 3.0, 0.1)
    x_m, y_m = (plane.ravel() for plane in np.meshgrid(side_m, side_m))
    return np.stack([x_m, y_m, np.zeros_like(x_m)], axis=1).astype(np.float32)


def _points(layout: PointLayout) -> NDArray[np.void]:
    (time, time_format, time_at), (laser, laser_format, laser_at), point_bytes = layout
    offsets = [0, 4, 8, time_at, laser_at]
    formats = ["<f4", "<f4", "<f4", time_format, laser_format]
    names: dict[str, Any] = {"names": ["x", "y", "z", time, laser], "formats": formats, "offsets": offsets}
    record: np.dtype[np.void] = np.dtype({**names, "itemsize": point_bytes})  # type: ignore[call-overload]
    points = np.ones(4, record)
    points[time] = np.arange(1, 5) * (0.02 if time_format == "<f8" else 2e7)
    points.setflags(write=False)
    return points
