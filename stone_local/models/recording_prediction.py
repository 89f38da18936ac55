"""Prediction straight from a recording: a loop over its frames in time order, as on a robot.

        bag + calibration → synchronised sequence → frames → classes → files

**Conventions.** A prediction sees its frame (the sweep, and the frame's images and scans) and earlier frames, nothing
later. Some of a frame's images are taken after its stamp: `waits_ms` is how long a robot would wait for them. Only
stamps and poses are read of the whole recording in advance. Memory holds a few frames.
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

# Frames of a recording as a dataset reads them: the content of an export, made frame by frame. The bytes of each datum
# equal those that `stone export` writes and its pose is the one in the tables, so the readers and the geometry of
# exports (`baselines/frame_record.py`) apply. Global is the map. Only the frame table grows with the recording; images
# and points are in memory for one frame at a time.


@dataclass(frozen=True, eq=False)
class RecordedContent:
    """The file that an export would have of a channel's `number`-th datum."""

    samples: SampleSource
    channel: NuscenesChannel
    number: int

    def read(self, most_bytes: int) -> bytes:
        """Return the bytes. Raises `damaged_sample`, and what `sample_file` raises."""
        content, _ = sample_file(self.samples, self.channel, self.number)
        if len(content) > most_bytes:
            raise self.damaged(f"it has {len(content)} bytes, expected at most {most_bytes}")
        return content

    def damaged(self, why: str) -> Refused:
        return Refused(
            "damaged_sample",
            f"frame {int(self.channel.frames[self.number])} cannot be predicted from the data of {self.channel.name} "
            f"recorded: {why}",
        )

    def identity(self) -> list[str | int]:
        return [self.channel.name, int(self.channel.stamps_ns[self.number])]


@dataclass(frozen=True, eq=False)
class RecordedStore:
    """A `FrameStore` over a synchronised sequence and its samples, in time order."""

    sequence: Sequence
    samples: SampleSource
    inputs: InputConfig

    def __len__(self) -> int:
        return len(self.sequence.frames)

    def key(self, index: int) -> tuple[str, int]:
        return self.sequence.name, int(self.sequence.frames.stamps_ns[index]) // NS_PER_US

    def read(self, index: int) -> FrameRecord:
        """Return the record of a frame. Raises `sensor_missing`, `damaged_sample`, and what reading samples raises
        (BAG-*, MSG-*).
        """
        return read_record(self.frame(index), None, self.inputs)

    def frame(self, index: int) -> ExportedFrame:
        """Return the frame with the data that it would have in an export, all of them unread."""
        token = self.sequence.frames.tokens[index]
        return ExportedFrame(token, *self.key(index), self._data(index), None)

    def longest_wait_ns(self) -> int:
        """Return the longest delay after its stamp of a frame's image or scan, of the channels that the row uses."""
        stamps_ns = self.sequence.frames.stamps_ns
        return max(
            (int((channel.stamps_ns - stamps_ns[channel.frames]).max(initial=0)) for channel in self._channels),
            default=0,
        )

    def _data(self, index: int) -> Mapping[str, ExportedDatum]:
        data = ((channel, channel.place(index)) for channel in self._channels)
        return {
            channel.name: ExportedDatum(
                self._sensors[channel.name],
                int(channel.stamps_ns[datum]) // NS_PER_US,
                channel.map_from_ego[datum],
                RecordedContent(self.samples, channel, datum),
            )
            for channel, datum in data
            if datum is not None and self._is_there(channel, index)
        }

    def _is_there(self, channel: NuscenesChannel, index: int) -> bool:
        """Return whether a radar's scan can be read; images are read at their first use."""
        return channel.modality != "radar" or self.samples.radar(channel.name, index) is not None

    @cached_property
    def _channels(self) -> tuple[NuscenesChannel, ...]:
        """Return the channels that the row uses; always with the LiDAR, since its sweeps define the frames."""
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
        """Return the intrinsics of a camera, for the size of its first readable image. Raises `sample_gone`."""
        if channel.mount.intrinsics is None:
            return None
        seen = (self.samples.camera(channel.name, int(index)) for index in channel.frames)
        first = next((picture for picture in seen if picture is not None), None)
        if first is None:
            raise SampleGoneError(int(channel.frames[0]), channel.name)
        return replace(channel.mount.intrinsics, width_px=first.width_px, height_px=first.height_px)


def recorded_hz(sequence: Sequence) -> float | None:
    """Return the recorded frame rate; None for a single frame."""
    steps_ns = np.diff(sequence.frames.stamps_ns)
    return 1e9 / float(np.median(steps_ns)) if len(steps_ns) else None


PREDICTION = "prediction.json"
Paces = Callable[[PredictionPace], None]


@dataclass(frozen=True, eq=False)
class RecordingPlan:
    """A synchronised recording and the output: a folder, or with a manifest the submission of its frames."""

    bag: Path
    sequence: Sequence
    output: Path
    manifest: Path | None = None


@dataclass(frozen=True)
class RecordingPrediction:
    """The record of a prediction; `real_time_ratio` is 1 if it keeps up with the sensors."""

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
    """Predict each frame, or the frames of the manifest, and report the pace after each.

    Raises what reading samples raises (BAG-*, MSG-*), `bad_manifest`, `not_of_recording`, `sensor_missing`,
    `damaged_sample`, `output_exists`.
    """
    sequence = plan.sequence
    store = RecordedStore(sequence, BagSamples(plan.bag, sequence), loaded.row.inputs)
    indices = _wanted_indices(plan, loaded)
    begun, hz = monotonic(), recorded_hz(sequence)
    pace = PredictionPace(0, len(indices), 0.0, hz)

    def files() -> Iterator[tuple[str, bytes]]:
        nonlocal pace
        for done, (index, grid) in enumerate(loaded.predicted(store, indices), start=1):
            yield sequence.frames.tokens[index], frame_file(grid, loaded.row.label_grid)
            pace = PredictionPace(done, len(indices), monotonic() - begun, hz)
            paces(pace)

    def record() -> RecordingPrediction:
        record_fields = asdict(loaded.written(plan.output, len(indices)))
        ratio, waits_ms = pace.real_time_ratio, store.longest_wait_ns() / 1e6
        return RecordingPrediction(
            **record_fields,
            sequence=sequence.name,
            frames_per_s=pace.frames_per_s,
            real_time_ratio=ratio,
            waits_ms=waits_ms,
        )

    if plan.manifest is None:
        _write_folder(plan.output, files(), record)
    else:
        write_files(plan.output, files())
    return record()


def _wanted_indices(plan: RecordingPlan, loaded: LoadedRun) -> tuple[int, ...]:
    """Return the indices of the frames to predict, in time order. Raises `bad_manifest`, `grids_differ`,
    `not_of_recording`.
    """
    tokens = plan.sequence.frames.tokens
    if plan.manifest is None:
        return tuple(range(len(tokens)))
    places = {token: index for index, token in enumerate(tokens)}
    manifest = read_manifest(plan.manifest)
    loaded.require_grid(manifest.grid)
    wanted = manifest.tokens
    missing = [token for token in wanted if token not in places]
    if missing:
        raise Refused(
            "not_of_recording",
            f"{len(missing)} frames of the manifest are not of this recording as sequence {plan.sequence.name} "
            f"(the first is {missing[0]}): tokens depend on the sequence's name (--sequence). For several "
            "sequences predict from their exports",
        )
    return tuple(sorted(places[token] for token in wanted))


def _write_folder(output: Path, files: Iterator[tuple[str, bytes]], record: Callable[[], RecordingPrediction]) -> None:
    """Write `<frame_token>.npz` of each frame and `prediction.json`; on failure the folder stays as it was."""
    with atomic_directory(output, replaces=PREDICTION) as staging:
        for token, content in files:
            (staging / f"{token}.npz").write_bytes(content)
        (staging / PREDICTION).write_text(json.dumps(asdict(record()), indent=1) + "\n", "utf-8")
