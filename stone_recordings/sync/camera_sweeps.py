"""Pairs of a sweep and a camera's picture of the same scene, compensated for the robot's motion between them.

    camera(t)_from_lidar(stamp) = (map_from_ego(t) @ ego_from_lidar @ lidar_from_camera)⁻¹
                                  @ map_from_ego(stamp) @ ego_from_lidar

**Conventions.** t is the image's stamp on the LiDAR's clock: frame stamp + `dt_ns` of the association. A frame whose
image time has no pose gives no pair. A sweep is opened once for all cameras that share its frame.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone.geometry.se3 import SE3
from stone.geometry.trajectory import DEFAULT_MAX_GAP_NS, Trajectory
from stone.sensors.calibration import Mount
from stone.sensors.sequence import Association, Sequence
from stone_recordings.bags.bag import Bag
from stone_recordings.sync.sweeps import BagSweeps


@dataclass(frozen=True, eq=False)
class CameraSweepPair:
    """One picture (message `message_index` of `topic`) and the points (N, 3) of its frame's sweep.

    `points_camera` are in the mount's optical frame at the image's time; `points_lidar` as the sweep has them.
    """

    mount: Mount
    topic: str
    message_index: int
    points_lidar: NDArray[np.float64]
    camera_from_lidar: SE3

    @property
    def points_camera(self) -> NDArray[np.float64]:
        return self.camera_from_lidar @ self.points_lidar


def camera_mounts(sequence: Sequence) -> tuple[Mount, ...]:
    """Return the cameras of the calibration that can project and have pictures in the recording."""
    associations = sequence.frames.associations
    cameras = sequence.calibration.of_kind("camera")
    return tuple(mount for mount in cameras if mount.intrinsics is not None and mount.name in associations)


def pairs(bag: Bag, sequence: Sequence, sweeps: BagSweeps, count: int) -> Iterator[CameraSweepPair]:
    """Yield up to `count` pairs of every camera, at frames spread over the sequence.

    Raises the errors of `sweeps.sweep_in`.
    """
    mounts = camera_mounts(sequence)
    chosen = {mount.name: set(_spread(usable_frames(sequence, sweeps, mount.name), count)) for mount in mounts}
    for frame in sorted(set[int]().union(*chosen.values())):
        points_lidar = sweeps.sweep_in(bag, frame).points_lidar.astype(np.float64)
        for mount in mounts:
            if frame in chosen[mount.name] and len(points_lidar):
                yield _pair(sequence, sweeps, mount, (frame, points_lidar))


def _pair(
    sequence: Sequence, sweeps: BagSweeps, mount: Mount, swept: tuple[int, NDArray[np.float64]]
) -> CameraSweepPair:
    frame, points_lidar = swept
    association = sequence.frames.associations[mount.name]
    stamp_ns = int(sequence.frames.stamps_ns[frame])
    times_ns = np.array([stamp_ns, stamp_ns + int(association.dt_ns[frame])], np.int64)
    trajectory, max_gap_ns = _motion(sequence, sweeps)
    map_from_ego = trajectory.at(times_ns, max_gap_ns).map_from_ego
    map_from_lidar = map_from_ego @ sequence.calibration.ego_from_lidar
    camera_from_lidar = (map_from_lidar[1] @ mount.lidar_from_sensor).inverse() @ map_from_lidar[0]
    return CameraSweepPair(
        mount, association.topic, int(association.message_index[frame]), points_lidar, camera_from_lidar
    )


def shown_message(sequence: Sequence, sweeps: BagSweeps, channel: str) -> int | None:
    """Return the index of the message whose picture one pair of this camera has, else of any; None if it has none."""
    taken = sequence.frames.associations[channel].message_index
    usable = usable_frames(sequence, sweeps, channel)
    frames = usable if len(usable) else np.flatnonzero(taken >= 0)
    return int(taken[_spread(frames, 1)[0]]) if len(frames) else None


def usable_frames(sequence: Sequence, sweeps: BagSweeps, channel: str) -> NDArray[np.int64]:
    """Return the frames that have a picture of this camera and a pose at its time."""
    association: Association = sequence.frames.associations[channel]
    trajectory, max_gap_ns = _motion(sequence, sweeps)
    has_pose = trajectory.at(sequence.frames.stamps_ns + association.dt_ns, max_gap_ns).is_ok
    return np.flatnonzero((association.message_index >= 0) & has_pose)


def _motion(sequence: Sequence, sweeps: BagSweeps) -> tuple[Trajectory, int]:
    """Return the track that deskewed the sweeps; the frames' own poses if the sweeps are not deskewed."""
    if sweeps.mount is not None:
        return sweeps.mount.trajectory, sweeps.mount.max_gap_ns
    return Trajectory(sequence.frames.stamps_ns, sequence.frames.map_from_ego), DEFAULT_MAX_GAP_NS


def _spread(frames: NDArray[np.int64], count: int) -> list[int]:
    """Return `count` of the frames, in the middles of as many equal parts; all frames if there are fewer."""
    if len(frames) <= count:
        return [int(frame) for frame in frames]
    places = (np.arange(count) + 0.5) / count * len(frames)
    return [int(frame) for frame in frames[places.astype(np.int64)]]
