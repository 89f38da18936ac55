"""The sweeps of a recording, deskewed, by frame: opened where they are needed, in whichever process that is.

**Conventions.** Sweeps in order are cheap (a chunk is inflated once); the recording is opened once per process and
thread and stays open. Points that carry no time are returned as they are.
"""

import os
import threading
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stone.sensors.deskew import SweepMount, deskew
from stone.sensors.sequence import Sweep
from stone_recordings.bags.bag import Bag, open_bag
from stone_recordings.messages.pointcloud2 import lidar_points
from stone_recordings.messages.sweep_clouds import cloud_at


@dataclass(frozen=True, eq=False)
class BagSweeps:
    """A SweepSource over one LiDAR topic; `message_index` and `stamps_ns` (N,) say which message each frame is.

    Picklable: it carries the path, never the open file. `mount` is None where sweeps are taken as they are.
    """

    path: Path
    topic: str
    message_index: NDArray[np.int64]
    stamps_ns: NDArray[np.int64]
    mount: SweepMount | None

    def __len__(self) -> int:
        return len(self.message_index)

    def sweep(self, index: int) -> Sweep:
        """The sweep of frame `index`; it may have no points.

        Raises IndexError; what opening and decoding raise (BAG-*, MSG-*); PointOffsetError of `stone.sensors.deskew`.
        """
        return self.sweep_in(opened(self.path), index)

    def sweep_in(self, bag: Bag, index: int) -> Sweep:
        """As `sweep`, from the recording that the caller has open. Raises as it does, but for opening."""
        stamp_ns = int(self.stamps_ns[index])
        cloud = cloud_at(bag, self.topic, int(self.message_index[index]))
        found = lidar_points(cloud, with_ring=False)
        if self.mount is None or found.offset_ns is None:
            return Sweep(stamp_ns, found.points_lidar, found.beyond)
        moved = deskew(found.points_lidar, found.offset_ns, self.mount, stamp_ns)
        return Sweep(stamp_ns, moved, found.beyond)


@dataclass(frozen=True, eq=False)
class SweepsOfOpenBag:
    """The sweeps as a SweepSource over the recording that somebody has open already."""

    sweeps: BagSweeps
    bag: Bag

    def sweep(self, index: int) -> Sweep:
        """As `BagSweeps.sweep_in`."""
        return self.sweeps.sweep_in(self.bag, index)


def opened(path: Path) -> Bag:
    """The recording, open in this process and thread; it stays so."""
    status = path.stat()
    return _opened_once(path, (status.st_mtime_ns, status.st_size), (os.getpid(), threading.get_ident()))


@lru_cache(maxsize=4)
def _opened_once(path: Path, version: tuple[int, int], reader: tuple[int, int]) -> Bag:
    """`version` reopens a recording that was replaced; `reader` keeps forks and threads from sharing a cursor."""
    return open_bag(path)
