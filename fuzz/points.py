"""Fuzzing of messages of points and of raw pictures.

**Conventions.** For `points` the first byte selects the message type; the rest is the message. For `pictures` all bytes
are the message. A message with a sound head must be readable.
"""

from collections.abc import Iterator
from functools import partial

import numpy as np

from stone.errors import StoneError
from stone_recordings.messages.camera import IMAGE, picture_of, picture_problem
from stone_recordings.messages.lidars.models import COMPRESSED_CLOUD
from stone_recordings.messages.pointcloud2 import lidar_points
from stone_recordings.messages.sweep_clouds import points_declared, points_problem, sweep_cloud, sweep_problem
from stone_recordings.messages.yuv import ENCODINGS, row_bytes, rows_of
from testing.worlds.field.drive import FieldDrive
from testing.worlds.field.point_messages import (
    COMPRESSED,
    COMPRESSED_FIELDS,
    PACKERS,
    compressed_message,
    livox_definitions,
    livox_message,
)

LIVOX = "livox_ros_driver2/msg/CustomMsg"
TYPES = (LIVOX, COMPRESSED_CLOUD)
SEED_POINTS, WIDTH_PX, HEIGHT_PX = 12, 6, 5


def read_points(content: bytes) -> None:
    """Read the head of a message, then its points."""
    if not content:
        return
    payload, type_name = memoryview(content[1:]), TYPES[content[0] % len(TYPES)]
    points_declared(payload[:256], type_name)
    is_sound = not points_problem(payload, type_name, partial(len, payload)) and not sweep_problem(payload, type_name)
    try:
        lidar_points(sweep_cloud(payload, type_name))
    except StoneError as error:
        if is_sound:
            raise AssertionError(f"its head is sound, but reading failed: {error}") from error
        raise


def read_raw_picture(content: bytes) -> None:
    """Read the head of a picture, then its pixels."""
    payload = memoryview(content)
    picture_problem(payload, IMAGE, partial(len, payload))
    picture_of(IMAGE, payload, 320)


def point_seeds() -> Iterator[tuple[str, bytes]]:
    """Yield a few points in each message and compression."""
    drive = FieldDrive(definitions=(*livox_definitions(), (COMPRESSED, COMPRESSED_FIELDS)))
    message = livox_message(drive, 0.0)
    message.points = message.points[:SEED_POINTS]
    yield "livox", b"\0" + bytes(drive.store.serialize_cdr(message, LIVOX))
    for name in PACKERS:
        packed = compressed_message(drive, 0.0, name, SEED_POINTS)
        yield name.replace(" ", "-"), b"\1" + bytes(drive.store.serialize_cdr(packed, COMPRESSED))


def raw_picture_seeds() -> Iterator[tuple[str, bytes]]:
    """Yield a small picture of each encoding."""
    drive = FieldDrive()
    steps = {"mono8": WIDTH_PX, "bgr8": 3 * WIDTH_PX, "bayer_rggb8": WIDTH_PX}
    for encoding in (*steps, *sorted(ENCODINGS)):
        step = steps.get(encoding) or row_bytes(encoding, WIDTH_PX)
        data = np.arange(step * rows_of(encoding, HEIGHT_PX), dtype=np.uint8)
        message = drive.of(IMAGE, drive.header(0.0, "cam"), HEIGHT_PX, WIDTH_PX, encoding, 0, step, data)
        yield encoding, bytes(drive.store.serialize_cdr(message, IMAGE))
