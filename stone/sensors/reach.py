"""Reach of a LiDAR: the check for points that can be returns, used wherever points are read or moved.

**Conventions.** A position is metres from the sensor. Non-finite values are out of reach: NaN fails every comparison,
and the square of values too large for their type is infinite. Points are checked when they are read
(`stone_recordings.messages.lidar`) and when they are transformed to the ego frame (`stone.sensors.selection`); the
deskewing motion (`stone.sensors.deskew`) is checked by its translation. Later kernels therefore receive only finite
positions, whatever a recording contains.
"""

from numba import njit

FARTHEST_POINT_M = 1000.0  # no LiDAR of a robot or a car reports returns beyond half of this


@njit(inline="always")
def is_in_reach(x, y, z):  # type: ignore[no-untyped-def]
    """Return whether a position is finite and at most `FARTHEST_POINT_M` away."""
    return x * x + y * y + z * z <= FARTHEST_POINT_M * FARTHEST_POINT_M
