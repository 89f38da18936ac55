"""Half of a LiDAR's measurements: every other sweep, or every other ring of each sweep."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from stone.errors import Refused
from stone.sensors.sequence import Sweep
from stone_recordings.clocks.point_clock import points_at
from stone_recordings.messages.lidar import RING_NAMES
from stone_recordings.sync.sweeps import BagSweeps, opened

Halving = Literal["sweeps", "rings"]


@dataclass(frozen=True, eq=False)
class HalvedSweeps:
    """A SweepSource of one half of another: `half` 0 holds the even sweeps or rings, 1 the odd ones.

    A sweep of the other half stays a sweep, without points, so that both halves have the same frames.
    """

    source: BagSweeps
    by: Halving
    half: int

    def sweep(self, index: int) -> Sweep:
        """Return the sweep of frame `index`, or its half. Raises as `BagSweeps.sweep` does, and `no_rings`."""
        if self.by == "rings":
            whole, rings = self.source.sweep(index), self._rings(index)
            return replace(whole, points_lidar=whole.points_lidar[rings % 2 == self.half])
        if index % 2 == self.half:
            return self.source.sweep(index)
        return Sweep(int(self.source.stamps_ns[index]), np.empty((0, 3), np.float32))

    def _rings(self, index: int) -> NDArray[np.uint16]:
        """Return the ring of each point of the whole sweep, (N,)."""
        source = self.source
        rings = points_at(opened(source.path), source.topic, int(source.message_index[index])).ring
        if rings is None:
            raise Refused("no_rings", f"the points of {source.topic} have none of the fields {', '.join(RING_NAMES)}")
        return rings
