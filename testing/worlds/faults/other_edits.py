"""Edits of transforms, IMU, cameras and radars, damage to files, and wrong calibrations.

**Conventions.** As in `testing.worlds.faults.edits`.
"""

import copy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap.records import ChunkIndex

from stone.geometry.se3 import SE3
from stone.sensors.calibration import Calibration
from testing.worlds.faults.fault import Misreading

CRC_OFFSET_BYTES = 33  # in a Chunk record: opcode u8, length, start, end and uncompressed size u64, then the CRC


def tf_cycle(message: Any) -> Any:
    """Add the inverse of every transform."""
    for transform in list(message.transforms):
        back = copy.deepcopy(transform)
        back.header.frame_id, back.child_frame_id = transform.child_frame_id, transform.header.frame_id
        message.transforms.append(back)
    return message


def tf_nan(message: Any) -> Any:
    message.transforms[0].transform.translation.x = float("nan")
    return message


def imu_of_nothing(message: Any) -> Any:
    for vector in (message.linear_acceleration, message.angular_velocity):
        vector.x = vector.y = vector.z = 0.0
    return message


def imu_nan(message: Any) -> Any:
    message.angular_velocity.z = message.linear_acceleration.x = float("nan")
    return message


def picture_of_garbage(message: Any) -> Any:
    message.data = np.random.default_rng(5).integers(0, 256, len(message.data)).astype(np.uint8)
    return message


def picture_of_nothing(message: Any) -> Any:
    message.data = message.data[:0]
    return message


def picture_cut(message: Any) -> Any:
    message.data = message.data[: len(message.data) // 2]
    return message


def lens_of_zeros(message: Any) -> Any:
    message.k = np.zeros(9)
    message.d = np.full(len(message.d), np.nan)
    return message


def detections_nan(message: Any) -> Any:
    for detection in message.list_detections:
        detection.f_range = float("nan")
    return message


def lowered(by_m: float) -> Misreading:
    """Enter the LiDAR lower than it is, by this length."""
    lower = SE3.from_parts(np.array([1.0, 0, 0, 0]), np.array([0.0, 0.0, -by_m]))
    return lambda rig: replace(rig, ego_from_lidar=lower @ rig.ego_from_lidar)


def rolled(by_deg: float, axis: int = 0) -> Misreading:
    """Enter the LiDAR turned about its own axis x (roll), y (pitch) or z (yaw)."""
    wxyz = np.zeros(4)
    wxyz[0], wxyz[1 + axis] = np.cos(np.deg2rad(by_deg) / 2), np.sin(np.deg2rad(by_deg) / 2)
    turn = SE3.from_parts(wxyz, np.zeros(3))
    return lambda rig: _with_lidar(rig, rig.ego_from_lidar @ turn)


def _with_lidar(rig: Calibration, ego_from_lidar: SE3) -> Calibration:
    return replace(rig, ego_from_lidar=ego_from_lidar)


def bad_chunk(path: Path) -> None:
    """Change one byte of the chunk in the middle."""
    chunk = _middle_chunk(path)
    _flip(path, chunk.chunk_start_offset + chunk.chunk_length // 2)


def bad_checksum(path: Path) -> None:
    """Change the checksum of the chunk in the middle; its data stay sound, for any compression."""
    _flip(path, _middle_chunk(path).chunk_start_offset + CRC_OFFSET_BYTES)


def _middle_chunk(path: Path) -> ChunkIndex:
    with path.open("rb") as reading:
        summary = make_reader(reading).get_summary()
    assert summary is not None
    return summary.chunk_indexes[len(summary.chunk_indexes) // 2]


def _flip(path: Path, at: int) -> None:
    """Change the byte at this offset of a file."""
    with path.open("r+b") as file:
        file.seek(at)
        byte = file.read(1)[0]
        file.seek(at)
        file.write(bytes([byte ^ 0x55]))


def cut_off(path: Path) -> None:
    """Remove the last third of the file."""
    with path.open("r+b") as file:
        file.truncate(path.stat().st_size * 2 // 3)


def trailing_zeros(path: Path) -> None:
    """Append zeros, as a disk that fills whole blocks."""
    with path.open("ab") as file:
        file.write(bytes(4096))
