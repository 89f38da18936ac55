"""Coverage of the robot's way by T: in how many places that its footprint went over the labels say so.

**Conventions.** Places lie in a lattice inside the footprint, so far from its edge that the voxel of each is under it.
One is covered when T lies in its voxel, the one above or the one below; it is closed when it is covered or its
neighbours on two opposite sides are, as a frame's grid closes pinholes (`stone.labels.pinholes`).
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
PLACES_AT_ONCE = 50_000  # of all poses that are looked at together

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class TrackCoverage:
    """Of how many places along the way, how many are closed; of how many poses along it, how many have none."""

    places: int
    closed: int
    poses: int
    bare: int

    @property
    def closed_ratio(self) -> float:
        """1 of no place."""
        return self.closed / self.places if self.places else 1.0

    @property
    def bare_ratio(self) -> float:
        """0 of no pose."""
        return self.bare / self.poses if self.poses else 0.0

    def __add__(self, other: "TrackCoverage") -> "TrackCoverage":
        return TrackCoverage(
            self.places + other.places, self.closed + other.closed, self.poses + other.poses, self.bare + other.bare
        )


def places_of(footprint: Footprint) -> NDArray[np.float64]:
    """The places (C, 3) under the footprint, in the ego plane; the middle line of one that is too narrow for more."""
    halves = (max(size / 2 - INSIDE_M, 0.0) for size in (footprint.length_m, footprint.width_m))
    x, y = (np.linspace(-half, half, 1 + int(np.ceil(2 * half / SPACING_M))) for half in halves)
    return np.stack(np.meshgrid(x, y, 0.0, indexing="ij"), axis=-1).reshape(-1, 3)


def covered_places(driven: Keys, poses: SE3, footprint: Footprint) -> tuple[Mask, Mask]:
    """Which of the places under the footprint at each pose (P, C) are covered by the T voxels `driven`, and which are
    closed."""
    nothing = np.zeros((0, len(places_of(footprint))), np.bool_)
    found = [(nothing, nothing), *_covered_in_turn(driven, poses, footprint)]
    return np.concatenate([own for own, _ in found]), np.concatenate([closed for _, closed in found])


def coverage(driven: Keys, poses: SE3, footprint: Footprint) -> TrackCoverage:
    """Of the way through these poses with the T voxels `driven`."""
    total = TrackCoverage(0, 0, 0, 0)
    for _, closed in _covered_in_turn(driven, poses, footprint):
        total += TrackCoverage(closed.size, int(closed.sum()), len(closed), int((~closed.any(axis=1)).sum()))
    return total


def spaced(poses: SE3) -> SE3:
    """The first of the poses (P, P ≥ 1), and one every `STEP_M` of the way through them."""
    driven_m = np.append(0.0, np.cumsum(steps_of(poses)[0]))
    return poses[np.append(True, np.diff(np.floor(driven_m / STEP_M)) > 0)]


def _covered_in_turn(driven: Keys, poses: SE3, footprint: Footprint) -> Iterator[tuple[Mask, Mask]]:
    """As `covered_places`, of a few poses after another: a footprint may be as large as a calibration says."""
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
    """Of each place whether one of its three points (P, 3 C, 3) lies in one of the voxels."""
    found = np.isin(keys_of(points.reshape(-1, 3), VOXEL_M), driven)
    return np.asarray(found.reshape(len(points), -1, 3).any(axis=2))
