"""Six cameras of a viewed run: pictures, lenses and mounts, and their playback.

**Conventions.** They point away from the robot, 60° apart; the first has a distorting lens. Each takes its picture
after the frame, when the robot has driven and turned further (`shutter_pose`): the farther left, the later.
"""

import io
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from services.domain.viewer.formats import PlaybackCameras, cameras_bytes
from services.domain.viewer.playback import CAMERAS, PLAYBACK, camera_file
from services.runtime.orm import Upload
from services.runtime.platform import Platform
from stone.geometry.se3 import SE3
from stone.sensors.calibration import CameraIntrinsics
from stone.sensors.projection import rays_through
from testing.api.serving import Person
from testing.worlds import made
from testing.worlds.rows import recording_of

Floats = NDArray[Any]
CHANNELS = {
    "CAM_FRONT": 0.0,
    "CAM_FRONT_LEFT": 60.0,
    "CAM_BACK_LEFT": 120.0,
    "CAM_BACK": 180.0,
    "CAM_BACK_RIGHT": 240.0,
    "CAM_FRONT_RIGHT": 300.0,
}
"""Camera directions, degrees to the left of forward."""
BENT = CameraIntrinsics("plumb_bob", 640, 400, 320, 322, 318, 203, (-0.12, 0.01, 1e-3, -5e-4, 0.0))
PINHOLE = CameraIntrinsics("pinhole", 640, 400, 320, 320, 319.5, 199.5)
OPTICAL = SE3(np.array([0.5, -0.5, 0.5, -0.5, 0.0, 0.0, 0.0]))  # a camera along x: z forward, y down


def lens_of(channel: str) -> CameraIntrinsics:
    """Return the lens of a camera; only the front camera's distorts."""
    return BENT if channel == "CAM_FRONT" else PINHOLE


def shutter_pose(channel: str) -> SE3:
    """Return `ego_from_camera`: a metre above the robot's position at the shutter, in the ego frame of the frame."""
    degrees = CHANNELS[channel]
    yaw, late = np.radians(degrees), degrees / 360.0
    mounted = (
        SE3(np.array([np.cos(yaw / 2), 0, 0, np.sin(yaw / 2), 0.3 * np.cos(yaw), 0.3 * np.sin(yaw), 1.0])) @ OPTICAL
    )
    turned = 0.03 * late
    return SE3(np.array([np.cos(turned / 2), 0, 0, np.sin(turned / 2), 0.6 * late, 0.01 * late, 0.0])) @ mounted


def camera_files(tokens: list[str], without: tuple[str, int] | None = None) -> dict[str, bytes]:
    """Return pictures in a colour per camera and frame, and `cameras.bin`; `without` drops this channel and frame."""
    has_picture = np.ones((len(CHANNELS), len(tokens)), np.bool_)
    files = dict[str, bytes]()
    for index, channel in enumerate(CHANNELS):
        for number, token in enumerate(tokens):
            if (channel, number) == without:
                has_picture[index, number] = False
                continue
            files[camera_file(channel, token)] = _picture(40 * index, min(255, 20 * number))
    poses = [shutter_pose(channel).wxyz_xyz for channel in CHANNELS]
    each = np.stack([np.concatenate([pose[4:], pose[:4]]) for pose in poses])
    rays = np.stack([_rays(lens_of(channel)) for channel in CHANNELS])
    placed = np.repeat(each[:, None], len(tokens), axis=1)
    return {**files, CAMERAS: cameras_bytes(PlaybackCameras(has_picture, rays, placed))}


def _rays(lens: CameraIntrinsics, columns: int = 33, rows: int = 21) -> Floats:
    across, down = np.linspace(-0.5, lens.width_px - 0.5, columns), np.linspace(-0.5, lens.height_px - 0.5, rows)
    pixels = np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2)
    return rays_through(pixels, lens).reshape(rows, columns, 3)


@cache
def _picture(red: int, green: int) -> bytes:
    stream = io.BytesIO()
    Image.new("RGB", (320, 200), (red, green, 120)).save(stream, "JPEG")
    return stream.getvalue()


def played(platform: Platform, owner: Person, sequence_id: str, files: dict[str, bytes]) -> None:
    """Create a playback of these files, for a sequence that gets a recording."""
    upload_id = made.upload(platform, owner)
    with platform.database.transaction() as session:
        session.add(recording_of(session.get_one(Upload, upload_id), sequence_id, "registered"))
    made.export(platform, sequence_id, files, PLAYBACK)
