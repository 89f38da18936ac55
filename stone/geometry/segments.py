"""Segments of a track (unbroken stretches), numbered in time order; a new segment starts after every jump and every
gap.

**Conventions.** A gap is a step longer than `max_gap_ns`; the trajectory is already split at jumps
(`stone.geometry.jumps`). A time belongs to the segment of the last pose at or before it; times before all poses belong
to the first segment.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from stone.geometry.trajectory import Trajectory


def split_at_gaps(trajectory: Trajectory, max_gap_ns: int) -> Trajectory:
    """Return the trajectory with a new segment after each gap, or itself if there are none."""
    is_gap = np.diff(trajectory.stamps_ns) > max_gap_ns
    if not is_gap.any():
        return trajectory
    is_new = is_gap | (np.diff(trajectory.segments) != 0)
    return replace(trajectory, segment=np.concatenate([[0], np.cumsum(is_new)]).astype(np.int64))


def segments_at(trajectory: Trajectory, stamps_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the segment (N,) at every time (N,)."""
    before = np.searchsorted(trajectory.stamps_ns, stamps_ns, side="right") - 1
    return np.asarray(trajectory.segments[np.maximum(before, 0)])
