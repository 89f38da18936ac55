"""The sweeps of a recording, deskewed, by frame; any process can open them.

**Conventions.** Reading sweeps in order is cheap (a chunk is inflated once). The recording is opened once per process
and thread and stays open. Points without times are returned unchanged.
"""

import io
import json
import os
import threading
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stone.geometry.se3 import SE3
from stone.geometry.trajectory import Trajectory
from stone.sensors.deskew import SweepMount, deskew
from stone.sensors.sequence import Sweep
from stone_files.npz import npz_bytes
from stone_recordings.bags.bag import Bag, open_bag
from stone_recordings.clocks.point_clock import points_at
from stone_recordings.sync.stored_recording import StoredRecording, StoredRecordingFile


@dataclass(frozen=True, eq=False)
class BagSweeps:
    """A SweepSource over one LiDAR topic; `message_index` and `stamps_ns` (N,) give the message of each frame.

    Picklable: it carries the path, never the open file. `mount` is None if sweeps are not deskewed. A recording that
    `is_in_place` is read sparingly.
    """

    path: Path
    topic: str
    message_index: NDArray[np.int64]
    stamps_ns: NDArray[np.int64]
    mount: SweepMount | None
    is_in_place: bool = False

    def __len__(self) -> int:
        return len(self.message_index)

    def sweep(self, index: int) -> Sweep:
        """Return the sweep of frame `index`; it may have no points.

        Raises IndexError, the errors of opening and decoding (BAG-*, MSG-*), `point_offset` of `stone.sensors.deskew`.
        """
        return self.sweep_in(opened(self.path, is_in_place=self.is_in_place), index)

    def sweep_in(self, bag: Bag, index: int) -> Sweep:
        """Return `sweep` from a recording that the caller has open; raises the same errors except those of opening."""
        stamp_ns = int(self.stamps_ns[index])
        points = points_at(bag, self.topic, int(self.message_index[index]), with_ring=False)
        if self.mount is None or points.offset_ns is None:
            is_timed = points.offset_ns is not None or not len(points.points_lidar)
            return Sweep(stamp_ns, points.points_lidar, points.beyond, points.mistimed, is_timed)
        moved = deskew(points.points_lidar, points.offset_ns, self.mount, stamp_ns)
        return Sweep(stamp_ns, moved, points.beyond, points.mistimed)


@dataclass(frozen=True, eq=False)
class SweepsOfOpenBag:
    """The sweeps as a SweepSource over an open recording."""

    sweeps: BagSweeps
    bag: Bag

    def sweep(self, index: int) -> Sweep:
        """Return `BagSweeps.sweep_in`."""
        return self.sweeps.sweep_in(self.bag, index)


def opened(path: Path, *, is_in_place: bool = False) -> Bag:
    """Return the recording, open in this process and thread; it stays open."""
    status = path.stat()
    bag = _opened_once(path, (status.st_mtime_ns, status.st_size), (os.getpid(), threading.get_ident()))
    if is_in_place:
        bag.read_sparingly()
    return bag


@lru_cache(maxsize=4)
def _opened_once(path: Path, version: tuple[int, int], reader: tuple[int, int]) -> Bag:
    """Open the recording; `version` reopens a replaced file, `reader` keeps forks and threads from sharing a cursor."""
    return open_bag(path)


# The source of a sequence's sweeps, as a file that a worker on any machine can open: the fields of `BagSweeps` in an
# npz of plain arrays. Object keys name the recording in the store, since a path holds on one machine only. Workers of
# one version write and read it.


def sweeps_bytes(sweeps: BagSweeps, kept: StoredRecording) -> bytes:
    """Return the file; it does not contain `sweeps.path`."""
    record: dict[str, Any] = {"name": kept.name, "files": [asdict(file) for file in kept.files], "topic": sweeps.topic}
    arrays: dict[str, NDArray[Any]] = {"message_index": sweeps.message_index, "stamps_ns": sweeps.stamps_ns}
    if sweeps.mount is not None:
        record["max_gap_ns"] = sweeps.mount.max_gap_ns
        arrays["pose_stamps_ns"] = sweeps.mount.trajectory.stamps_ns
        arrays["map_from_ego"] = sweeps.mount.trajectory.map_from_ego.wxyz_xyz
        if sweeps.mount.trajectory.segment is not None:
            arrays["pose_segment"] = sweeps.mount.trajectory.segment
        arrays["ego_from_lidar"] = sweeps.mount.ego_from_lidar.wxyz_xyz
    return npz_bytes({"record": np.frombuffer(json.dumps(record).encode(), np.uint8), **arrays})


def read_sweeps(payload: bytes, locate: Callable[[StoredRecording], Path]) -> BagSweeps:
    """Return the sweeps; `locate` returns the path of the recording on this machine."""
    with np.load(io.BytesIO(payload), allow_pickle=False) as arrays:
        record = json.loads(arrays["record"].tobytes())
        mount = None
        if "max_gap_ns" in record:
            poses = SE3(arrays["map_from_ego"])
            trajectory = Trajectory(arrays["pose_stamps_ns"], poses, dict(arrays).get("pose_segment"))
            mount = SweepMount(trajectory, SE3(arrays["ego_from_lidar"]), record["max_gap_ns"])
        path = locate(StoredRecording(record["name"], tuple(StoredRecordingFile(**file) for file in record["files"])))
        return BagSweeps(path, record["topic"], arrays["message_index"], arrays["stamps_ns"], mount)
