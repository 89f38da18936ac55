"""Sensor data for the viewer: reduced camera images, thinned sweeps and radar detections.

    playback.json   cameras.bin   cameras/<CHANNEL>/<frame_token>.jpg   clouds/<frame_token>.bin
    radars/<frame_token>.bin

**Conventions.** Pictures are at most `WIDTH_PX` wide and keep the lens's distortion. A sweep keeps at most
`MOST_POINTS` points in the ego frame. They are selected evenly by the golden ratio, so every ring and section is
represented, and equal sweeps give equal points. Missing, damaged and oversized pictures are left out. `cameras.bin`
relates the pictures to the labels (below); it is absent if there is no picture. The exporter holds one frame in memory.
"""

import io
from collections.abc import Sequence as Listing
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from services.domain.viewer.formats import PlaybackCameras, cameras_bytes, cloud_bytes, detections_bytes
from services.domain.viewer.playback import (
    CAMERAS,
    INDEX,
    PlacedSensor,
    PlaybackChannels,
    camera_file,
    cloud_file,
    index_record,
    radar_file,
)
from services.labeler.exports.nuscenes.plan import LIDAR
from services.labeler.exports.source import LabelledSequence
from services.labeler.previews.picture_opening import opened
from services.labeler.run import Step
from stone.geometry.se3 import SE3
from stone.sensors.calibration import CameraIntrinsics
from stone.sensors.projection import rays_through
from stone.sensors.samples import CameraSample, LidarSample, RadarSample, egos_at
from stone.sensors.sequence import Sequence

WIDTH_PX, JPEG_QUALITY = 640, 78
MOST_POINTS = 40_000
GOLDEN = (5.0**0.5 - 1.0) / 2.0
FULL_INTENSITY = 255.0


def write_playback(source: LabelledSequence, out: Path, step: Step) -> None:
    """Write the playback. Raises what reading samples raises (BAG-*, MSG-*)."""
    sequence, total = source.sequence, len(source.sequence.frames)
    channels = [mount.name for mount in sequence.calibration.of_kind("camera")]
    taken = [channel for channel in channels if channel in sequence.frames.associations]
    for channel in taken:
        (out / "cameras" / channel).mkdir(parents=True)
    (out / "clouds").mkdir()
    has_clouds = total > 0 and sequence.frames.sweeps is not None
    radars = [
        entry.name for entry in sequence.calibration.of_kind("radar") if entry.name in sequence.frames.associations
    ]
    has_radars = has_clouds and bool(radars) and sequence.track is not None
    (out / "radars").mkdir()
    has_picture = np.zeros((len(taken), total), np.bool_)
    for index, token in enumerate(sequence.frames.tokens):
        for camera, channel in enumerate(taken):
            picture = small_picture(source.samples.camera(channel, index))
            if picture is not None:
                (out / camera_file(channel, token)).write_bytes(picture)
                has_picture[camera, index] = True
        if has_clouds:
            sweep = source.samples.lidar(index)
            (out / cloud_file(token)).write_bytes(small_cloud(sweep, sequence.calibration.ego_from_lidar))
        if has_radars:
            scans = [scan for radar in radars if (scan := source.samples.radar(radar, index)) is not None]
            (out / radar_file(token)).write_bytes(detections(scans, sequence.calibration.ego_from_lidar))
        step(index + 1, total)
    is_shown = has_picture.any(axis=1)
    cameras = tuple(taken[camera] for camera in np.flatnonzero(is_shown))
    if cameras:
        (out / CAMERAS).write_bytes(cameras_bytes(playback_cameras(sequence, cameras, has_picture[is_shown])))
    shown = PlaybackChannels(cameras, has_clouds, bool(cameras), placed_sensors(sequence), has_radars)
    (out / INDEX).write_bytes(index_record(shown))


def placed_sensors(sequence: Sequence) -> tuple[PlacedSensor, ...]:
    """Return the LiDAR, unless the sequence has no sweeps, and every mount of the rig, in its order."""
    calibration = sequence.calibration
    lidar = (
        [] if sequence.frames.sweeps is None else [PlacedSensor(LIDAR, "lidar", pose_of(calibration.ego_from_lidar))]
    )
    placed = (
        (mount.name, mount.kind, calibration.ego_from_lidar @ mount.lidar_from_sensor) for mount in calibration.mounts
    )
    return (*lidar, *(PlacedSensor(name, kind, pose_of(pose)) for name, kind, pose in placed))


def pose_of(transform: SE3) -> tuple[float, ...]:
    """Return tx ty tz qw qx qy qz."""
    return (*transform.translation_m.tolist(), *transform.wxyz.tolist())


def small_picture(sample: CameraSample | None) -> bytes | None:
    """Return the picture as a JPEG at most `WIDTH_PX` wide; None if it is missing or unreadable."""
    if sample is None:
        return None
    scale = min(1.0, WIDTH_PX / max(sample.width_px, 1))
    size_px = (max(1, round(sample.width_px * scale)), max(1, round(sample.height_px * scale)))
    picture = opened(sample, size_px)
    if isinstance(picture, str):
        return None
    file = io.BytesIO()
    picture.resize(size_px, Image.Resampling.BILINEAR, reducing_gap=2.0).save(file, "JPEG", quality=JPEG_QUALITY)
    return file.getvalue()


def small_cloud(sample: LidarSample, ego_from_lidar: SE3) -> bytes:
    """Return the sweep as `STC1`; intensities between 0 and 1 are scaled to 0 to 255."""
    kept = drawn(len(sample.points_lidar), MOST_POINTS)
    intensity = sample.intensity[kept].astype(np.float64)
    intensity[~np.isfinite(intensity)] = 0.0
    if intensity.max(initial=0.0) <= 1.0:
        intensity *= FULL_INTENSITY
    points_ego = ego_from_lidar @ sample.points_lidar[kept].astype(np.float64)
    return cloud_bytes(points_ego, intensity)


def detections(scans: Listing[RadarSample], ego_from_lidar: SE3) -> bytes:
    """Return the detections of all radars of a frame as `STE1`, moved to its stamp."""
    points_lidar = np.concatenate([np.empty((0, 3)), *(scan.points_lidar for scan in scans)])
    rates_m_s = np.concatenate([np.empty(0), *(scan.ground_rate_m_s for scan in scans)])
    return detections_bytes(ego_from_lidar @ points_lidar, rates_m_s)


def drawn(total: int, most: int) -> NDArray[np.int64]:
    """Return at most `most` of the rows 0 to `total`, in order, selected by the golden ratio."""
    rows = np.arange(total)
    return rows if total <= most else rows[(rows * GOLDEN) % 1.0 < most / total][:most]


# The cameras of a playback, with the rays of their lenses, and their pose at each picture.
# `ego_from_camera = map_from_ego(frame)⁻¹ @ map_from_ego(shutter) @ ego_from_lidar @ lidar_from_camera`.
# Labels are in the frame's ego, but pictures are taken up to a revolution later, so the pose includes the robot's
# motion in between. The rays of a lens are a grid over its image from edge to edge (`COLUMNS` × `ROWS`). If a viewer
# interpolates between nodes, it errs by less than a tenth of a pixel of 640. A camera without intrinsics has NaN rays,
# a picture without its own pose a NaN pose.


Array = NDArray[np.float64]
COLUMNS, ROWS = 33, 21


def playback_cameras(sequence: Sequence, channels: Listing[str], has_picture: NDArray[np.bool_]) -> PlaybackCameras:
    """Return the cameras of these channels, in this order; `has_picture` is (C, N)."""
    total = len(sequence.frames)
    rays, poses = np.full((len(channels), ROWS, COLUMNS, 3), np.nan), np.full((len(channels), total, 7), np.nan)
    for index, channel in enumerate(channels):
        mount = sequence.calibration.mount(channel)
        if mount is None or mount.intrinsics is None:
            continue
        rays[index] = lens_rays(mount.intrinsics)
        poses[index] = shutter_poses(sequence, channel)
    return PlaybackCameras(has_picture, rays, poses)


def lens_rays(intrinsics: CameraIntrinsics) -> Array:
    """Return unit vectors (ROWS, COLUMNS, 3), optical frame."""
    across = np.linspace(-0.5, intrinsics.width_px - 0.5, COLUMNS)
    down = np.linspace(-0.5, intrinsics.height_px - 0.5, ROWS)
    pixels = np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2)
    return rays_through(pixels, intrinsics).reshape(ROWS, COLUMNS, 3)


def shutter_poses(sequence: Sequence, channel: str) -> Array:
    """Return `ego_from_camera` (N, 7) of a calibrated camera, tx ty tz qw qx qy qz."""
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
