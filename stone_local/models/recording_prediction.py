"""Predicting straight from a recording: a loop over its frames in the order of time, as a robot has them.

    bag + calibration → synchronised sequence → frames → classes → files

**Conventions.** A prediction sees its frame (the sweep, and the pictures and scans that the frame takes) and earlier
frames, nothing later. Some of a frame's pictures are taken after its stamp: `waits_ms` is how long a robot would wait
for them. What is read of the whole recording first are stamps and poses. Memory holds a few frames.
"""

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from time import monotonic

import numpy as np

from baselines.frame_record import FrameRecord, read_record
from baselines.inputs import InputConfig
from baselines.predict import LoadedRun
from services.labeler.exports.nuscenes.plan import NS_PER_US, NuscenesChannel, channels_of
from services.labeler.exports.nuscenes.samples import SampleGoneError, sample_file
from stone.errors import Refused
from stone.sensors.calibration import CameraIntrinsics
from stone.sensors.samples import SampleSource
from stone.sensors.sequence import Sequence
from stone_exports.frames import ExportedDatum, ExportedFrame, ExportedSensor
from stone_files.atomic import atomic_directory
from stone_local.models.prediction_pace import PredictionPace
from stone_recordings.sync.samples import BagSamples
from stone_submissions.archive import frame_file, write_files
from stone_submissions.manifest import read_manifest

# Frames of a recording as a dataset reads them: what an export of it would hold, made frame by frame.
#
# **Conventions.** The bytes of each datum are those that `stone export` writes and its pose is the one in the tables,
# so that the readers and the geometry of exports (`baselines/frame_record.py`) are all there is. Global is the map.
# What grows with the recording is the frame table; pictures and points are there for one frame at a time.


@dataclass(frozen=True, eq=False)
class RecordedContent:
    """The file that an export would have of a channel's `place`-th datum."""

    samples: SampleSource
    channel: NuscenesChannel
    place: int

    def read(self, most_bytes: int) -> bytes:
        """Raises `damaged_sample`, and what `sample_file` raises."""
        content, _ = sample_file(self.samples, self.channel, self.place)
        if len(content) > most_bytes:
            raise self.damaged(f"it has {len(content)} bytes, expected at most {most_bytes}")
        return content

    def damaged(self, why: str) -> Refused:
        return Refused(
            "damaged_sample",
            f"frame {int(self.channel.frames[self.place])} cannot be predicted from the data of {self.channel.name} "
            f"recorded: {why}",
        )

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
        """Raises `sensor_missing`, `damaged_sample`, and what reading samples raises (BAG-*, MSG-*)."""
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
            if place is not None and self._is_there(channel, index)
        }

    def _is_there(self, channel: NuscenesChannel, index: int) -> bool:
        """Whether a radar's scan can be read; pictures are read when they are looked at."""
        return channel.modality != "radar" or self.samples.radar(channel.name, index) is not None

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
        """A camera's, of pictures as large as its first that can be read. Raises `sample_gone`."""
        if channel.mount.intrinsics is None:
            return None
        seen = (self.samples.camera(channel.name, int(index)) for index in channel.frames)
        first = next((picture for picture in seen if picture is not None), None)
        if first is None:
            raise SampleGoneError(int(channel.frames[0]), channel.name)
        return replace(channel.mount.intrinsics, width_px=first.width_px, height_px=first.height_px)


def recorded_hz(sequence: Sequence) -> float | None:
    """Frames a second as they were recorded; None of a single frame."""
    steps_ns = np.diff(sequence.frames.stamps_ns)
    return 1e9 / float(np.median(steps_ns)) if len(steps_ns) else None


PREDICTION = "prediction.json"
Paces = Callable[[PredictionPace], None]


@dataclass(frozen=True, eq=False)
class RecordingPlan:
    """Which recording, synchronised, and where to: a folder, or with a manifest the submission of its frames."""

    bag: Path
    sequence: Sequence
    output: Path
    manifest: Path | None = None


@dataclass(frozen=True)
class RecordingPrediction:
    """What was written, what made it, and how fast: `real_time_ratio` is 1 where it keeps up with the sensors."""

    output: str
    frames: int
    method: str
    modality: str
    steps: int
    data_sha256: str
    sequence: str
    frames_per_s: float
    real_time_ratio: float | None
    waits_ms: float


def predict_recording(loaded: LoadedRun, plan: RecordingPlan, paces: Paces) -> RecordingPrediction:
    """Predict each frame, or those of the manifest, and tell the pace after each.

    Raises what reading samples raises (BAG-*, MSG-*), `bad_manifest`, `not_of_recording`, `sensor_missing`,
    `damaged_sample`, `output_exists`.
    """
    sequence = plan.sequence
    store = RecordedStore(sequence, BagSamples(plan.bag, sequence), loaded.row.inputs)
    indices = _asked(plan, loaded)
    begun, hz = monotonic(), recorded_hz(sequence)
    pace = PredictionPace(0, len(indices), 0.0, hz)

    def files() -> Iterator[tuple[str, bytes]]:
        nonlocal pace
        for done, (index, grid) in enumerate(loaded.predicted(store, indices), start=1):
            yield sequence.frames.tokens[index], frame_file(grid, loaded.row.label_grid)
            pace = PredictionPace(done, len(indices), monotonic() - begun, hz)
            paces(pace)

    def record() -> RecordingPrediction:
        said = asdict(loaded.written(plan.output, len(indices)))
        ratio, waits_ms = pace.real_time_ratio, store.longest_wait_ns() / 1e6
        return RecordingPrediction(
            **said, sequence=sequence.name, frames_per_s=pace.frames_per_s, real_time_ratio=ratio, waits_ms=waits_ms
        )

    if plan.manifest is None:
        _write_folder(plan.output, files(), record)
    else:
        write_files(plan.output, files())
    return record()


def _asked(plan: RecordingPlan, loaded: LoadedRun) -> tuple[int, ...]:
    """Indices of the frames to predict, in the order of time. Raises `bad_manifest`, `grids_differ`,
    `not_of_recording`."""
    tokens = plan.sequence.frames.tokens
    if plan.manifest is None:
        return tuple(range(len(tokens)))
    places = {token: index for index, token in enumerate(tokens)}
    manifest = read_manifest(plan.manifest)
    loaded.require_grid(manifest.grid)
    asked = manifest.tokens
    missing = [token for token in asked if token not in places]
    if missing:
        raise Refused(
            "not_of_recording",
            f"{len(missing)} frames of the manifest are not of this recording as sequence {plan.sequence.name} "
            f"(the first is {missing[0]}): tokens depend on the sequence's name (--sequence). For several "
            "sequences predict from their exports",
        )
    return tuple(sorted(places[token] for token in asked))


def _write_folder(output: Path, files: Iterator[tuple[str, bytes]], record: Callable[[], RecordingPrediction]) -> None:
    """`<frame_token>.npz` of each frame and `prediction.json`: whole, or as it was before."""
    with atomic_directory(output, replaces=PREDICTION) as staging:
        for token, content in files:
            (staging / f"{token}.npz").write_bytes(content)
        (staging / PREDICTION).write_text(json.dumps(asdict(record()), indent=1) + "\n", "utf-8")
