"""A scene of a published dataset as a synchronised sequence, in the form of sequences from recordings.

**Conventions.** The map is the dataset's `global`, bit by bit; tokens are the dataset's. A channel's association counts
its key-frame data by stamp. The track follows the ego poses of all data; if several data have one stamp, the
LiDAR's is used, else the first.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from stone.geometry.lattice import BIAS
from stone.geometry.se3 import SE3
from stone.geometry.trajectory import Trajectory
from stone.labels.voxels import VOXEL_M
from stone.sensors.calibration import Calibration, Mount
from stone.sensors.sequence import Association, Frames, Sequence
from stone_base.label_grid import LabelGrid
from stone_datasets.build import NS_PER_US, PlacedData
from stone_datasets.faults import DatasetPlace
from stone_datasets.index import DatasetChannel, DatasetSequence
from stone_exports.frames import LIDAR_CHANNEL
from stone_files.dataset_faults import DatasetFaultError

POSE_SOURCE = "dataset"
Poses = tuple[NDArray[np.int64], NDArray[np.float64]]


def farthest_m(grid: LabelGrid) -> float:
    """Return the largest distance of frames from the origin at which their grids are entirely within the lattice."""
    return (BIAS - 2) * VOXEL_M - 2 * max(map(abs, (*grid.min_m, *grid.max_m)))


def sequence_of(scene: DatasetSequence, data: Poses, inputs: Mapping[str, str], grid: LabelGrid) -> Sequence:
    """Return the sequence of a scene; `data` are the stamps (N,) and ego poses (N, 7) of its data, the LiDAR's first.

    Raises `DST-049`.
    """
    reach_m = float(np.abs(scene.map_from_ego.translation_m).max())
    if reach_m >= farthest_m(grid):
        what = (
            f"scene {scene.name} extends {reach_m:.0f} m from its origin, but at most {farthest_m(grid):.0f} m can be "
            "mapped"
        )
        raise DatasetFaultError("DST-049", DatasetPlace("ego_pose"), what)
    stamps_ns, first = np.unique(data[0], return_index=True)
    others = {name: channel for name, channel in scene.channels.items() if name != LIDAR_CHANNEL}
    every, none = np.arange(len(scene), dtype=np.int64), np.zeros(len(scene), np.int64)
    frames = Frames(
        scene.stamps_ns,
        scene.tokens,
        scene.map_from_ego,
        {name: _association(scene, channel) for name, channel in others.items()},
        sweeps=Association(LIDAR_CHANNEL, every, none) if LIDAR_CHANNEL in scene.channels else None,
    )
    track = Trajectory(stamps_ns, SE3(data[1][first]))
    return Sequence(scene.name, frames, (), _calibration(scene), POSE_SOURCE, inputs=inputs, track=track)


def placed_data(placed: PlacedData, rows: NDArray[np.int64]) -> Poses:
    """Return stamps and ego poses of these rows of sample_data, the rows of a scene."""
    is_other = np.array([mount.sensor.channel != LIDAR_CHANNEL for mount in placed.mounts], np.bool_)
    rows = rows[np.argsort(is_other[placed.mount[rows]], kind="stable")]
    poses = placed.tables.poses.poses.array(np.float64).reshape(-1, 7)
    return placed.stamps_us[rows] * NS_PER_US, poses[placed.pose[rows]]


def annotated_data(scene: DatasetSequence) -> Poses:
    """Return stamps and ego poses of frames, then of pictures."""
    channels = scene.channels.values()
    stamps_ns = np.concatenate([scene.stamps_ns, *(channel.stamps_ns for channel in channels)])
    poses = [scene.map_from_ego.wxyz_xyz, *(channel.map_from_ego.wxyz_xyz for channel in channels)]
    return stamps_ns, np.concatenate(poses)


def _association(scene: DatasetSequence, channel: DatasetChannel) -> Association:
    index, dt_ns = np.full(len(scene), -1, np.int64), np.zeros(len(scene), np.int64)
    index[channel.frames] = np.arange(len(channel.frames))
    dt_ns[channel.frames] = channel.stamps_ns - scene.stamps_ns[channel.frames]
    return Association(channel.sensor.channel, index, dt_ns)


def _calibration(scene: DatasetSequence) -> Calibration:
    """Return `lidar_from_sensor` of every channel except LIDAR_TOP; without it, the LiDAR's frame is the ego frame."""
    lidar = scene.channels.get(LIDAR_CHANNEL)
    ego_from_lidar = SE3.identity() if lidar is None else lidar.sensor.ego_from_sensor
    sensors = [channel.sensor for name, channel in scene.channels.items() if name != LIDAR_CHANNEL]
    mounts = [
        Mount(
            sensor.channel,
            sensor.modality,  # type: ignore[arg-type]  # camera, lidar or radar
            ego_from_lidar.inverse() @ sensor.ego_from_sensor,
            intrinsics=sensor.intrinsics,
        )
        for sensor in sensors
    ]
    return Calibration(scene.vehicle or scene.name, ego_from_lidar, tuple(mounts))
