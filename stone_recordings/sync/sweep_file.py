"""The source of a sequence's sweeps, as a file that a worker on any machine can open.

**Conventions.** What `BagSweeps` knows, in an npz of plain arrays; instead of a path, which is true on one machine
only, object keys name the recording in the store. Written and read by workers of one version.
"""

import io
import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stone.geometry.se3 import SE3
from stone.geometry.trajectory import Trajectory
from stone.sensors.deskew import SweepMount
from stone_files.npz import npz_bytes
from stone_recordings.sync.stored_recording import StoredRecording, StoredRecordingFile
from stone_recordings.sync.sweeps import BagSweeps


def sweeps_bytes(sweeps: BagSweeps, kept: StoredRecording) -> bytes:
    """The file; `sweeps.path` is not in it."""
    record: dict[str, Any] = {**asdict(kept), "topic": sweeps.topic}
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
    """The sweeps; `locate` says where the recording lies on this machine."""
    with np.load(io.BytesIO(payload), allow_pickle=False) as arrays:
        record = json.loads(arrays["record"].tobytes())
        mount = None
        if "max_gap_ns" in record:
            poses = SE3(arrays["map_from_ego"])
            trajectory = Trajectory(arrays["pose_stamps_ns"], poses, dict(arrays).get("pose_segment"))
            mount = SweepMount(trajectory, SE3(arrays["ego_from_lidar"]), record["max_gap_ns"])
        path = locate(StoredRecording(record["name"], tuple(StoredRecordingFile(**file) for file in record["files"])))
        return BagSweeps(path, record["topic"], arrays["message_index"], arrays["stamps_ns"], mount)
