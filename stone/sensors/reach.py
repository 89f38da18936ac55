"""Reach of a LiDAR: which points can be returns at all. It is asked wherever points come in or were moved.

**Conventions.** A place is metres from the sensor. What is not finite is out of reach: NaN fails every comparison, and
the square of what is too far for its type is infinite. Points are asked when they are read
(`stone_recordings.messages.lidar`), again when they are put into the ego frame (`stone.sensors.selection`); the
motion that moves them between (`stone.sensors.deskew`) is asked for its translation. So no later kernel is given a
place that is not finite, whatever a recording holds.
"""

from numba import njit

FARTHEST_POINT_M = 1000.0  # no LiDAR of a robot or a car reports a return from beyond half of it


@njit(inline="always")
def is_in_reach(x, y, z):  # type: ignore[no-untyped-def]
    """Whether a place is finite and no farther away than `FARTHEST_POINT_M`."""
    return x * x + y * y + z * z <= FARTHEST_POINT_M * FARTHEST_POINT_M
