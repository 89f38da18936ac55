"""Predicting straight from a recording: a loop over its frames in the order of time, as a robot has them.

    bag + calibration → synchronised sequence → frames → classes → files

**Conventions.** A prediction sees its frame (the sweep, and the pictures and scans that the frame takes) and earlier
frames, nothing later. Some of a frame's pictures are taken after its stamp: `waits_ms` is how long a robot would wait
for them. What is read of the whole recording first are stamps and poses. Memory holds a few frames.
"""

import json
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from time import monotonic
from typing import ClassVar

from baselines.predict import LoadedRun
from stone.errors import StoneError
from stone.sensors.sequence import Sequence
from stone_files.atomic import atomic_directory
from stone_local.models.prediction_pace import PredictionPace
from stone_local.models.recorded_frames import RecordedStore, recorded_hz
from stone_recordings.sync.samples import BagSamples
from stone_submissions.manifest import read_manifest
from stone_submissions.writer import frame_file, write_files

PREDICTION = "prediction.json"
Paces = Callable[[PredictionPace], None]


class NotOfRecordingError(StoneError):
    """A manifest asks for frames that the recording does not have."""

    code: ClassVar[str] = "not_of_recording"

    def __init__(self, missing: int, first: str, name: str) -> None:
        super().__init__(
            f"{missing} frames of the manifest are not of this recording as sequence {name} (the first is {first}): "
            "tokens follow the sequence's name (--sequence), and a bag gives one sequence; several are predicted from "
            "their exports"
        )


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

    Raises what reading samples raises (BAG-*, MSG-*), `ManifestError`, `NotOfRecordingError`, `SensorMissingError`,
    `DamagedSampleError`, `OutputExistsError`.
    """
    sequence = plan.sequence
    store = RecordedStore(sequence, BagSamples(plan.bag, sequence), loaded.row.inputs)
    indices = _asked(plan)
    begun, hz = monotonic(), recorded_hz(sequence)
    pace = PredictionPace(0, len(indices), 0.0, hz)

    def files() -> Iterator[tuple[str, bytes]]:
        nonlocal pace
        for done, (index, grid) in enumerate(loaded.predicted(store, indices), start=1):
            yield sequence.frames.tokens[index], frame_file(grid)
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


def _asked(plan: RecordingPlan) -> tuple[int, ...]:
    """Indices of the frames to predict, in the order of time. Raises `ManifestError`, `NotOfRecordingError`."""
    tokens = plan.sequence.frames.tokens
    if plan.manifest is None:
        return tuple(range(len(tokens)))
    places = {token: index for index, token in enumerate(tokens)}
    asked = read_manifest(plan.manifest).tokens
    missing = [token for token in asked if token not in places]
    if missing:
        raise NotOfRecordingError(len(missing), missing[0], plan.sequence.name)
    return tuple(sorted(places[token] for token in asked))


def _write_folder(output: Path, files: Iterator[tuple[str, bytes]], record: Callable[[], RecordingPrediction]) -> None:
    """`<frame_token>.npz` of each frame and `prediction.json`: whole, or as it was before."""
    with atomic_directory(output, replaces=PREDICTION) as staging:
        for token, content in files:
            (staging / f"{token}.npz").write_bytes(content)
        (staging / PREDICTION).write_text(json.dumps(asdict(record()), indent=1) + "\n", "utf-8")
