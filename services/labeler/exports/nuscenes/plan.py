"""The plan of a sequence in nuScenes: its channels, their frames, times and poses, and all names.

**Conventions.** A scene is a sequence, a sample is a frame with the frame's token. `global` is the map shifted by whole
metres (`services/labeler/exports/nuscenes/layout.py`). The ego pose of a datum is the robot's pose at measurement, with
the datum's token. A camera or radar without a message near a frame, or without a pose at that time, has no datum there.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from services.labeler.exports.nuscenes.tables import token_of
from stone.geometry.se3 import SE3
from stone.sensors.calibration import Mount
from stone.sensors.samples import egos_at
from stone.sensors.sequence import Sequence

NS_PER_US, NS_PER_S = 1_000, 1_000_000_000
LIDAR = "LIDAR_TOP"
PLATFORM = "n001"
Modality = Literal["camera", "lidar", "radar"]
SUFFIX: dict[Modality, str] = {"camera": "jpg", "lidar": "pcd.bin", "radar": "pcd"}


@dataclass(frozen=True, eq=False)
class NuscenesChannel:
    """One sensor: the frames (K,) with data, ascending, and the stamp and robot pose of each datum."""

    name: str
    modality: Modality
    mount: Mount
    frames: NDArray[np.int64]
    stamps_ns: NDArray[np.int64]
    map_from_ego: SE3

    def place(self, frame: int) -> int | None:
        """Return the frame's position in `frames`; None if the sensor has no datum for it."""
        at = int(np.searchsorted(self.frames, frame))
        return at if at < len(self.frames) and self.frames[at] == frame else None


@dataclass(frozen=True, eq=False)
class NuscenesPlan:
    """The plan of a sequence; `low_m` is the map corner at the origin of `global`, `quality` is None without labels.

    If frames are not in time order (`is_ordered` is False), they have no previous and no next frame.
    """

    sequence: Sequence
    channels: tuple[NuscenesChannel, ...]
    low_m: tuple[int, int]
    quality: Mapping[str, Any] | None = None
    is_ordered: bool = True

    @property
    def logfile(self) -> str:
        """`n001-<UTC>` of the first frame."""
        begun = datetime.fromtimestamp(int(self.sequence.frames.stamps_ns[0]) // NS_PER_S, UTC)
        return begun.strftime(f"{PLATFORM}-%Y-%m-%d-%H-%M-%S+0000")

    @property
    def scene_token(self) -> str:
        return token_of("scene", self.sequence.name)

    @property
    def log_token(self) -> str:
        return token_of("log", self.sequence.name)

    def calibrated_token(self, channel: NuscenesChannel) -> str:
        return token_of("calibrated_sensor", self.sequence.name, channel.name)

    def datum_token(self, channel: NuscenesChannel, number: int) -> str:
        """Return the token of a channel's datum number `place`; "" outside, as the schema ends its chains."""
        if not 0 <= number < len(channel.frames):
            return ""
        return token_of("sample_data", self.sequence.frames.tokens[channel.frames[number]], channel.name)

    def filename(self, channel: NuscenesChannel, number: int) -> str:
        """`samples/<CHANNEL>/n001-<UTC>__<CHANNEL>__<µs>.<suffix>` (design §4)."""
        stamp_us = int(channel.stamps_ns[number]) // NS_PER_US
        return f"samples/{channel.name}/{self.logfile}__{channel.name}__{stamp_us}.{SUFFIX[channel.modality]}"

    @property
    def mask_filename(self) -> str:
        return f"maps/{token_of('map', self.sequence.name)}.png"


def channels_of(sequence: Sequence) -> tuple[NuscenesChannel, ...]:
    """Return the LiDAR, if any, then cameras with intrinsics, then radars, in calibration order."""
    frames = sequence.frames
    if frames.sweeps is None:
        return tuple(_others(sequence))
    lidar = Mount(LIDAR, "lidar", SE3.identity())
    every = np.arange(len(frames), dtype=np.int64)
    return (NuscenesChannel(LIDAR, "lidar", lidar, every, frames.stamps_ns, frames.map_from_ego), *_others(sequence))


def _others(sequence: Sequence) -> Iterator[NuscenesChannel]:
    calibration = sequence.calibration
    cameras = [mount for mount in calibration.of_kind("camera") if mount.intrinsics is not None]
    for mount in (*cameras, *calibration.of_kind("radar")):
        taken = sequence.frames.associations.get(mount.name)
        if taken is None:
            continue
        frames = np.flatnonzero(taken.message_index >= 0)
        stamps_ns = sequence.frames.stamps_ns[frames] + taken.dt_ns[frames]
        poses, is_ok = egos_at(sequence, frames, stamps_ns)
        modality: Modality = "camera" if mount.kind == "camera" else "radar"
        yield NuscenesChannel(mount.name, modality, mount, frames[is_ok], stamps_ns[is_ok], poses[is_ok])
