"""The cameras of a playback: the rays of their lenses, and where they were at each picture.

    ego_from_camera = map_from_ego(frame)⁻¹ @ map_from_ego(shutter) @ ego_from_lidar @ lidar_from_camera

**Conventions.** Labels stand in the frame's ego, pictures are taken up to a revolution later: the robot's motion in
between is in the pose. The rays of a lens are a grid over its image from edge to edge (`COLUMNS` × `ROWS`); between
its nodes a viewer interpolates, which is off by less than a tenth of a pixel of 640. A camera without intrinsics has no
rays, a picture without a pose of its own no pose: NaN.
"""

from collections.abc import Sequence as Listing

import numpy as np
from numpy.typing import NDArray

from services.domain.viewer.formats import PlaybackCameras
from stone.sensors.calibration import CameraIntrinsics
from stone.sensors.projection import rays_through
from stone.sensors.samples import egos_at
from stone.sensors.sequence import Sequence

Array = NDArray[np.float64]
COLUMNS, ROWS = 33, 21


def playback_cameras(sequence: Sequence, channels: Listing[str], has_picture: NDArray[np.bool_]) -> PlaybackCameras:
    """The cameras of these channels, in this order; `has_picture` is (C, N)."""
    total = len(sequence.frames)
    rays, poses = np.full((len(channels), ROWS, COLUMNS, 3), np.nan), np.full((len(channels), total, 7), np.nan)
    for place, channel in enumerate(channels):
        mount = sequence.calibration.mount(channel)
        if mount is None or mount.intrinsics is None:
            continue
        rays[place] = lens_rays(mount.intrinsics)
        poses[place] = shutter_poses(sequence, channel)
    return PlaybackCameras(has_picture, rays, poses)


def lens_rays(intrinsics: CameraIntrinsics) -> Array:
    """(ROWS, COLUMNS, 3) unit vectors, optical frame."""
    across = np.linspace(-0.5, intrinsics.width_px - 0.5, COLUMNS)
    down = np.linspace(-0.5, intrinsics.height_px - 0.5, ROWS)
    pixels = np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2)
    return rays_through(pixels, intrinsics).reshape(ROWS, COLUMNS, 3)


def shutter_poses(sequence: Sequence, channel: str) -> Array:
    """`ego_from_camera` (N, 7) of a camera that the calibration knows, tx ty tz qw qx qy qz."""
    frames, calibration = sequence.frames, sequence.calibration
    poses = np.full((len(frames), 7), np.nan)
    taken, mount = frames.associations.get(channel), calibration.mount(channel)
    if taken is None or mount is None:
        return poses
    rows = np.flatnonzero(taken.message_index >= 0)
    egos, _ = egos_at(sequence, rows, frames.stamps_ns[rows] + taken.dt_ns[rows])
    ego_from_ego = frames.map_from_ego[rows].inverse() @ egos
    placed = ego_from_ego @ calibration.ego_from_lidar @ mount.lidar_from_sensor
    poses[rows] = np.concatenate([placed.translation_m, placed.wxyz], axis=1)
    return poses
