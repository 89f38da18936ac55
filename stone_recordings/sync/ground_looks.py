"""The ground in sweeps along the way: read once, for the tilt of the LiDAR and for drift in z."""

from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone.errors import StoneError
from stone.geometry.placed_points import placed
from stone.geometry.se3 import SE3
from stone.sensors.calibration import Calibration
from stone.sensors.ego_path import maps_of_frames
from stone.sensors.ground_links import Links, Way, driven, links_between, look, looks_along
from stone.sensors.ground_points import around_robot
from stone.sensors.selection import world_points
from stone.sensors.sequence import Sequence, SweepSource
from stone.sensors.sweep_tilt import SweepTilt, sweep_tilt

AHEAD = 2
MIN_RANGE_M = 1.0


@dataclass(frozen=True, eq=False)
class SeenWay:
    """The frames (K,) of the sweeps that were read, their positions, the links of their ground, and its tilt from
    them.
    """

    rows: NDArray[np.int64]
    way: Way
    links: Links
    tilt: SweepTilt | None


def seen_along(sequence: Sequence, sweeps: SweepSource, level: SE3 | None = None) -> SeenWay:
    """Read sweeps along the way and return their ground; `level` first turns their points in the ego frame."""
    poses = sequence.frames.map_from_ego
    places_m = poses.translation_m
    rows = looks_along(places_m) if len(places_m) else np.zeros(0, np.int64)
    way = Way(places_m[rows, :2], driven(places_m)[rows], maps_of_frames(sequence)[rows])
    points = (around_robot(ground) for ground in seen_ahead(sequence, sweeps, rows.tolist()))
    at = poses[rows] if level is None else poses[rows] @ level
    looks = [look(placed(at[k], points_ego)) for k, points_ego in enumerate(points)]
    links = links_between(looks, way)
    return SeenWay(rows, way, links, sweep_tilt(links, way, at))


def seen_ahead(sequence: Sequence, sweeps: SweepSource, rows: Iterable[int]) -> Iterator[NDArray[np.float32]]:
    """Yield `seen_around` of these frames in order; a thread reads the next `AHEAD` frames in advance.

    Nothing else may read the sweeps meanwhile.
    """
    coming = deque[Future[NDArray[np.float32]]]()
    with ThreadPoolExecutor(1) as beside:
        for row in rows:
            coming.append(beside.submit(seen_around, sequence, sweeps, row))
            if len(coming) > AHEAD:
                yield coming.popleft().result()
        yield from (future.result() for future in coming)


def seen_around(sequence: Sequence, sweeps: SweepSource, index: int) -> NDArray[np.float32]:
    """Return `points_around` of a frame of the sequence."""
    return points_around(sequence.calibration, sweeps, index)


def points_around(calibration: Calibration, sweeps: SweepSource, index: int) -> NDArray[np.float32]:
    """Return the points (N, 3) of a sweep in its ego frame, without the robot's own; none for an unreadable sweep.

    Labelling reports unreadable sweeps.
    """
    try:
        points_lidar = sweeps.sweep(index).points_lidar
    except StoneError:
        return np.zeros((0, 3), np.float32)
    return world_points(points_lidar, calibration.ego_from_lidar, calibration.self_boxes_ego, MIN_RANGE_M)
