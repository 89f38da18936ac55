"""Quality of a pose: the solution type, its standard deviations, and the interval between its neighbours.

**Conventions.** A status is a rank, higher is better; between two poses the worse status applies. A standard deviation
is along east, north and up in metres, NaN if the source has none.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from stone.geometry.trajectory import Trajectory


class Rtk(IntEnum):
    """The type of the position solution; UNKNOWN if the source has none (odometry) or does not report it."""

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
    """For K poses: `rtk` (K,) uint8 of `Rtk` and `stdev_m` (K, 3), east, north, up."""

    rtk: NDArray[np.uint8]
    stdev_m: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PoseQuality:
    """For N frames: the worse of the two poses around each stamp, and the interval `gap_ns` (N,) between them, 0 at a
    pose.
    """

    gap_ns: NDArray[np.int64]
    rtk: NDArray[np.uint8]
    stdev_m: NDArray[np.float64]

    def rtk_words(self) -> list[str]:
        """Return "fixed", "float", … for each frame."""
        return [Rtk(status).word for status in self.rtk.tolist()]


def unknown_quality(count: int) -> SolutionQuality:
    """Return the quality of poses whose source reports none."""
    return SolutionQuality(np.full(count, Rtk.UNKNOWN, np.uint8), np.full((count, 3), np.nan))


def quality_at(trajectory: Trajectory, solution: SolutionQuality, stamps_ns: NDArray[np.int64]) -> PoseQuality:
    """Return the quality at stamps (N,) within the trajectory; `solution` belongs to its poses."""
    left, right = trajectory.around(stamps_ns)
    return PoseQuality(
        trajectory.stamps_ns[right] - trajectory.stamps_ns[left],
        np.minimum(solution.rtk[left], solution.rtk[right]),
        np.maximum(solution.stdev_m[left], solution.stdev_m[right]),
    )
