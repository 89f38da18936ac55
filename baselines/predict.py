"""Predicting frames by a trained row: a submission, frame by frame, from exports.

**Conventions.** A frame is predicted from itself and earlier frames of its sequence that the exports have. Where the
row's lattice is a part of the benchmark's grid, all outside of it is free. Memory holds a few frames.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from baselines.batch import moved
from baselines.checkpoint import WeightsProvenance, read_weights
from baselines.data import FrameDataset, FrameRequest
from baselines.frame_record import FrameRecord, read_record
from baselines.inputs import InputConfig
from baselines.lattice import grid_part
from baselines.models.architectures import build_model
from baselines.models.occupancy_model import OccupancyModel
from baselines.processes import usable_device
from baselines.row_config import RowConfig
from baselines.run_folder import read_run_row
from baselines.sources import frames_of
from stone.labels.grid import GRID_SHAPE
from stone_exports.errors import refuse_missing
from stone_exports.frames import ExportedFrame
from stone_exports.tables import exports_in
from stone_submissions.manifest import read_manifest
from stone_submissions.writer import frame_file, write_files

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class ExportedStore:
    """Frames of exports as a dataset reads them: undistorted and cut when they are asked for."""

    frames: Sequence[ExportedFrame]
    inputs: InputConfig

    def __len__(self) -> int:
        return len(self.frames)

    def key(self, index: int) -> tuple[str, int]:
        return self.frames[index].sequence, self.frames[index].stamp_us

    def read(self, index: int) -> FrameRecord:
        return read_record(self.frames[index], None, self.inputs)


@dataclass(frozen=True)
class PredictionPlan:
    """Which run predicts which frames (a manifest's path) of which exports, and where to."""

    run: Path
    exports: tuple[Path, ...]
    manifest: Path
    output: Path
    device: str = "cpu"


@dataclass(frozen=True)
class WrittenPrediction:
    """A written submission, and what made it."""

    output: str
    frames: int
    method: str
    modality: str
    steps: int
    data_sha256: str


def predict(plan: PredictionPlan, progress: Progress) -> WrittenPrediction:
    """Predict every frame of the manifest.

    Raises `BadRunError`, `BadRowError`, `ManifestError`, what reading exports raises, `FramesMissingError`.
    """
    row = read_run_row(plan.run)
    manifest = read_manifest(plan.manifest)
    frames = frames_of([files for path in plan.exports for files in exports_in(path)])
    places = {frame.token: index for index, frame in enumerate(frames)}
    refuse_missing(manifest.sequences, places)
    predictor, provenance = loaded_predictor(plan.run, row, plan.device)
    dataset = FrameDataset(ExportedStore(frames, row.inputs), FrameRequest(row.inputs, predictor.model.lattice))

    def predicted() -> Iterator[tuple[str, bytes]]:
        # In the order of time: frames share their earlier sweeps.
        for done, token in enumerate(sorted(manifest.tokens, key=places.__getitem__), start=1):
            yield token, frame_file(predictor.classes(dataset, places[token]))
            progress("predict", done, len(manifest.tokens))

    write_files(plan.output, predicted())
    said = (provenance.position.step, provenance.data_sha256)
    return WrittenPrediction(str(plan.output), len(manifest.tokens), row.method, row.inputs.modality, *said)


@dataclass(frozen=True, eq=False)
class Predictor:
    """A model in evaluation, on a device."""

    model: OccupancyModel[Any]
    device: torch.device
    precision: str

    def classes(self, dataset: FrameDataset, index: int) -> NDArray[np.uint8]:
        """Classes (256, 256, 32) of a frame."""
        batch = moved(dataset[0, index], self.device)
        with torch.inference_mode():
            with torch.autocast(self.device.type, torch.bfloat16, enabled=self.precision == "bfloat16"):
                outputs = self.model(batch)
            classes = self.model.logits(outputs, batch).argmax(dim=1)[0].to(torch.uint8)
        grid = np.zeros(GRID_SHAPE, np.uint8)
        grid[grid_part(self.model.lattice)] = classes.cpu().numpy()
        return grid


def loaded_predictor(run: Path, row: RowConfig, device: str) -> tuple[Predictor, WeightsProvenance]:
    """The run's model with its weights. Raises `BadRunError`, `NoAcceleratorError`."""
    own = usable_device(device)
    model = build_model(row.model).to(own)
    provenance = read_weights(run, model)
    return Predictor(model.eval(), own, row.training.precision), provenance
