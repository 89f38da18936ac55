"""Coverage of the robot's track by T: the share of places under its footprint that are labelled T.

**Conventions.** Places form a lattice inside the footprint, far enough from its edge that each place's voxel is under
it. A place is covered if its voxel, the one above or the one below is T. It is closed if it is covered or its
neighbours on two opposite sides are, like pinholes in a frame's grid (`stone.labels.pinholes`).
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone.geometry.lattice import Keys, keys_of
from stone.geometry.se3 import SE3, steps_of
from stone.labels.voxels import VOXEL_M
from stone.sensors.calibration import Footprint

SPACING_M = 0.1
INSIDE_M = VOXEL_M / np.sqrt(2)
STEP_M = 0.5
BESIDE = ((-1, 0), (1, 0), (0, -1), (0, 1))
PLACES_AT_ONCE = 50_000  # for all poses that are processed together

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class TrackCoverage:
    """The number of places along the track and of closed ones; the number of poses and of poses without a closed
    place.
    """

    places: int
    closed: int
    poses: int
    bare: int

    @property
    def closed_ratio(self) -> float:
        """The share of closed places, 1 if there is no place."""
        return self.closed / self.places if self.places else 1.0

    @property
    def bare_ratio(self) -> float:
        """The share of bare poses, 0 if there is no pose."""
        return self.bare / self.poses if self.poses else 0.0

    def __add__(self, other: "TrackCoverage") -> "TrackCoverage":
        return TrackCoverage(
            self.places + other.places, self.closed + other.closed, self.poses + other.poses, self.bare + other.bare
        )


def places_of(footprint: Footprint) -> NDArray[np.float64]:
    """Return the places (C, 3) under the footprint, in the ego plane; the centre line of a narrow footprint."""
    halves = (max(size / 2 - INSIDE_M, 0.0) for size in (footprint.length_m, footprint.width_m))
    x, y = (np.linspace(-half, half, 1 + int(np.ceil(2 * half / SPACING_M))) for half in halves)
    return np.stack(np.meshgrid(x, y, 0.0, indexing="ij"), axis=-1).reshape(-1, 3)


def covered_places(driven: Keys, poses: SE3, footprint: Footprint) -> tuple[Mask, Mask]:
    """Return which places under the footprint at each pose (P, C) are covered by the T voxels `driven`, and which are
    closed.
    """
    nothing = np.zeros((0, len(places_of(footprint))), np.bool_)
    masks = [(nothing, nothing), *_covered_in_turn(driven, poses, footprint)]
    return np.concatenate([own for own, _ in masks]), np.concatenate([closed for _, closed in masks])


def coverage(driven: Keys, poses: SE3, footprint: Footprint) -> TrackCoverage:
    """Return the coverage of the track through these poses by the T voxels `driven`."""
    total = TrackCoverage(0, 0, 0, 0)
    for _, closed in _covered_in_turn(driven, poses, footprint):
        total += TrackCoverage(closed.size, int(closed.sum()), len(closed), int((~closed.any(axis=1)).sum()))
    return total


def spaced(poses: SE3) -> SE3:
    """Return the first of the poses (P, P ≥ 1), and one every `STEP_M` along the track."""
    driven_m = np.append(0.0, np.cumsum(steps_of(poses)[0]))
    return poses[np.append(True, np.diff(np.floor(driven_m / STEP_M)) > 0)]


def _covered_in_turn(driven: Keys, poses: SE3, footprint: Footprint) -> Iterator[tuple[Mask, Mask]]:
    """Yield `covered_places` for a few poses at a time, because calibrations may have a large footprint."""
    few = max(1, PLACES_AT_ONCE // len(places_of(footprint)))
    for at in range(0, len(poses), few):
        yield _covered(driven, poses[at : at + few], footprint)


def _covered(driven: Keys, poses: SE3, footprint: Footprint) -> tuple[Mask, Mask]:
    above = np.array([[0.0, 0.0, -VOXEL_M], [0.0, 0.0, 0.0], [0.0, 0.0, VOXEL_M]])
    under = (places_of(footprint)[:, None] + above).reshape(-1, 3)
    points = np.stack([poses[row] @ under for row in range(len(poses))])
    own, *beside = (_is_in(driven, points + VOXEL_M * np.array([*step, 0.0])) for step in ((0, 0), *BESIDE))
    return own, own | (beside[0] & beside[1]) | (beside[2] & beside[3])


def _is_in(driven: Keys, points: NDArray[np.float64]) -> Mask:
    """Return whether one of each place's three points (P, 3 C, 3) lies in one of the voxels."""
    is_hit = np.isin(keys_of(points.reshape(-1, 3), VOXEL_M), driven)
    return np.asarray(is_hit.reshape(len(points), -1, 3).any(axis=2))
