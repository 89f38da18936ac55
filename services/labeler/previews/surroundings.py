"""The robot's outline and track, drawn on preview images."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from stone.geometry.se3 import SE3
from stone.labels.grid import GRID_MAX_M, GRID_MIN_M
from stone.sensors.calibration import Footprint
from stone.sensors.sequence import Sequence


def _nowhere() -> NDArray[np.float64]:
    return np.zeros((0, 3))


@dataclass(frozen=True, eq=False)
class Surroundings:
    """`track_ego` (P, 3): the whole run's poses in this frame's axes, in their order; most lie outside the grid."""

    track_ego: NDArray[np.float64] = field(default_factory=_nowhere)
    footprint: Footprint = field(default_factory=Footprint)


ALONE = Surroundings()


def surroundings_of(sequence: Sequence, index: int) -> Surroundings:
    """Of frame `index`."""
    poses = sequence.frames.map_from_ego
    ego_from_map: SE3 = poses[index].inverse()
    return Surroundings(ego_from_map @ poses.translation_m, sequence.calibration.footprint)


def runs_inside(track_ego: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """The pieces (P', 3) of a track that lie in the grid in plan."""
    low, high = np.array(GRID_MIN_M[:2]), np.array(GRID_MAX_M[:2])
    inside = ((track_ego[:, :2] >= low) & (track_ego[:, :2] < high)).all(axis=1)
    cuts = np.flatnonzero(np.diff(inside.astype(np.int8))) + 1
    pieces = np.split(track_ego, cuts)
    return [piece for piece in pieces if len(piece) and _is_inside(piece[0], low, high)]


def _is_inside(point: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64]) -> bool:
    return bool(((point[:2] >= low) & (point[:2] < high)).all())
