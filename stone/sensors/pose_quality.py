"""Quality of a pose: the kind of its solution, its standard deviations, how far apart its neighbours lie.

**Conventions.** A status is a rank, better is higher; between two poses the worse of both holds. A standard deviation
is along east, north and up, metres; NaN where the source says none.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from stone.geometry.trajectory import Trajectory


class Rtk(IntEnum):
    """What kind of solution the position is; UNKNOWN where the source has no such thing (odometry) or does not tell."""

    UNKNOWN = 0
    NONE = 1
    SINGLE = 2
    DIFFERENTIAL = 3
    FLOAT = 4
    FIXED = 5

    @property
    def word(self) -> str:
        return self.name.lower()


@dataclass(frozen=True, eq=False)
class SolutionQuality:
    """Of K poses: `rtk` (K,) uint8 of `Rtk` and `stdev_m` (K, 3), east, north, up."""

    rtk: NDArray[np.uint8]
    stdev_m: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PoseQuality:
    """Of N frames: the worse of the two poses around each stamp, and `gap_ns` (N,) between them, 0 on a pose."""

    gap_ns: NDArray[np.int64]
    rtk: NDArray[np.uint8]
    stdev_m: NDArray[np.float64]

    def rtk_words(self) -> list[str]:
        """ "fixed", "float", … of each frame."""
        return [Rtk(status).word for status in self.rtk.tolist()]


def unknown_quality(count: int) -> SolutionQuality:
    """Of poses whose source says nothing about them."""
    return SolutionQuality(np.full(count, Rtk.UNKNOWN, np.uint8), np.full((count, 3), np.nan))


def quality_at(trajectory: Trajectory, solution: SolutionQuality, stamps_ns: NDArray[np.int64]) -> PoseQuality:
    """The quality at stamps (N,) that lie within the trajectory; `solution` is of its poses."""
    left, right = trajectory.around(stamps_ns)
    return PoseQuality(
        trajectory.stamps_ns[right] - trajectory.stamps_ns[left],
        np.minimum(solution.rtk[left], solution.rtk[right]),
        np.maximum(solution.stdev_m[left], solution.stdev_m[right]),
    )
