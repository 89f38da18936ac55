"""Frames of a recording as a dataset reads them: what an export of it would hold, made frame by frame.

**Conventions.** The bytes of each datum are those that `stone export` writes and its pose is the one in the tables, so
that the readers and the geometry of exports (`baselines/frame_record.py`) are all there is. Global is the map. What
grows with the recording is the frame table; pictures and points are there for one frame at a time.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from baselines.frame_record import FrameRecord, read_record
from baselines.inputs import InputConfig
from services.labeler.exports.nuscenes.plan import NS_PER_US, NuscenesChannel, channels_of
from services.labeler.exports.nuscenes.samples import sample_file
from stone.errors import StoneError
from stone.sensors.calibration import CameraIntrinsics
from stone.sensors.samples import SampleSource
from stone.sensors.sequence import Sequence
from stone_exports.frames import ExportedDatum, ExportedFrame, ExportedSensor


class DamagedSampleError(StoneError):
    """The data of a sensor in a recording are damaged or incomplete."""

    code: ClassVar[str] = "damaged_sample"

    def __init__(self, channel: str, frame: int, why: str) -> None:
        super().__init__(f"frame {frame} cannot be predicted from what {channel} recorded: {why}")


@dataclass(frozen=True, eq=False)
class RecordedContent:
    """The file that an export would have of a channel's `place`-th datum."""

    samples: SampleSource
    channel: NuscenesChannel
    place: int

    def read(self, most_bytes: int) -> bytes:
        """Raises `DamagedSampleError`, and what `sample_file` raises."""
        content, _ = sample_file(self.samples, self.channel, self.place)
        if len(content) > most_bytes:
            raise self.damaged(f"it has {len(content)} bytes, at most {most_bytes} are expected")
        return content

    def damaged(self, why: str) -> DamagedSampleError:
        return DamagedSampleError(self.channel.name, int(self.channel.frames[self.place]), why)

    def identity(self) -> list[str | int]:
        return [self.channel.name, int(self.channel.stamps_ns[self.place])]


@dataclass(frozen=True, eq=False)
class RecordedStore:
    """A `FrameStore` over a synchronised sequence and its samples, in the order of time."""

    sequence: Sequence
    samples: SampleSource
    inputs: InputConfig

    def __len__(self) -> int:
        return len(self.sequence.frames)

    def key(self, index: int) -> tuple[str, int]:
        return self.sequence.name, int(self.sequence.frames.stamps_ns[index]) // NS_PER_US

    def read(self, index: int) -> FrameRecord:
        """Raises `SensorMissingError`, `DamagedSampleError`, and what reading samples raises (BAG-*, MSG-*)."""
        return read_record(self.frame(index), None, self.inputs)

    def frame(self, index: int) -> ExportedFrame:
        """The frame with the data that it would have in an export; none of them is read yet."""
        token = self.sequence.frames.tokens[index]
        return ExportedFrame(token, *self.key(index), self._data(index), None)

    def longest_wait_ns(self) -> int:
        """How long after its stamp a frame's last picture or scan was taken, of those that the row looks at."""
        stamps_ns = self.sequence.frames.stamps_ns
        return max((int((one.stamps_ns - stamps_ns[one.frames]).max(initial=0)) for one in self._channels), default=0)

    def _data(self, index: int) -> Mapping[str, ExportedDatum]:
        places = ((channel, channel.place(index)) for channel in self._channels)
        return {
            channel.name: ExportedDatum(
                self._sensors[channel.name],
                int(channel.stamps_ns[place]) // NS_PER_US,
                channel.map_from_ego[place],
                RecordedContent(self.samples, channel, place),
            )
            for channel, place in places
            if place is not None
        }

    @cached_property
    def _channels(self) -> tuple[NuscenesChannel, ...]:
        """Those that the row looks at; the LiDAR always, since it is what makes a frame."""
        return tuple(channel for channel in channels_of(self.sequence) if self._is_seen(channel))

    def _is_seen(self, channel: NuscenesChannel) -> bool:
        if channel.modality == "camera":
            return self.inputs.sees("C") and channel.name in self.inputs.channels and len(channel.frames) > 0
        return channel.modality == "lidar" or self.inputs.sees("R")

    @cached_property
    def _sensors(self) -> Mapping[str, ExportedSensor]:
        ego_from_lidar = self.sequence.calibration.ego_from_lidar
        return {
            channel.name: ExportedSensor(
                channel.name, channel.modality, ego_from_lidar @ channel.mount.lidar_from_sensor, self._lens(channel)
            )
            for channel in self._channels
        }

    def _lens(self, channel: NuscenesChannel) -> CameraIntrinsics | None:
        """A camera's, of pictures as large as its first."""
        if channel.mount.intrinsics is None:
            return None
        _, (width_px, height_px) = sample_file(self.samples, channel, 0)
        return replace(channel.mount.intrinsics, width_px=width_px, height_px=height_px)


def recorded_hz(sequence: Sequence) -> float | None:
    """Frames a second as they were recorded; None of a single frame."""
    steps_ns = np.diff(sequence.frames.stamps_ns)
    return 1e9 / float(np.median(steps_ns)) if len(steps_ns) else None
