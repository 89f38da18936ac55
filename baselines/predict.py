"""Prediction of frames with a trained row: a submission, frame by frame, from exports.

**Conventions.** The prediction of a frame uses it and earlier frames of its sequence in the exports. If the row's
lattice is a part of the benchmark's grid, voxels outside it are free. Memory holds a few frames.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from baselines.batch import moved
from baselines.checkpoint import WeightsProvenance, read_weights
from baselines.data import FrameDataset, FrameRequest, FrameStore
from baselines.frame_record import FrameRecord, read_record
from baselines.inputs import InputConfig
from baselines.lattice import grid_part
from baselines.models.architectures import build_model
from baselines.models.occupancy_model import OccupancyModel
from baselines.processes import usable_device
from baselines.row_config import RowConfig
from baselines.run_folder import read_run_row
from baselines.sources import frames_at
from stone.errors import Refused
from stone_base.label_grid import PAPER, LabelGrid
from stone_exports.files import refuse_missing
from stone_exports.frames import ExportedFrame
from stone_submissions.archive import frame_file, write_files
from stone_submissions.manifest import read_manifest

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class ExportedStore:
    """Frames of exports in the form of a dataset: undistorted and cut on demand."""

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
    """The run, the frames (a manifest's path), the exports and the output."""

    run: Path
    exports: tuple[Path, ...]
    manifest: Path
    output: Path
    device: str = "cpu"


@dataclass(frozen=True)
class WrittenPrediction:
    """A written submission, and its origin."""

    output: str
    frames: int
    method: str
    modality: str
    steps: int
    data_sha256: str


def predict(plan: PredictionPlan, progress: Progress) -> WrittenPrediction:
    """Predict every frame of the manifest.

    Raises `bad_run`, `bad_row`, `bad_manifest`, `grids_differ`, what reading exports raises, `frames_missing`.
    """
    loaded = loaded_run(plan.run, plan.device)
    manifest = read_manifest(plan.manifest)
    loaded.require_grid(manifest.grid)
    frames = frames_at(plan.exports)
    places = {frame.token: index for index, frame in enumerate(frames)}
    refuse_missing(manifest.sequences, places)
    in_order = sorted(places[token] for token in manifest.tokens)
    grids = loaded.predicted(ExportedStore(frames, loaded.row.inputs), in_order)

    def predicted() -> Iterator[tuple[str, bytes]]:
        for done, (index, grid) in enumerate(grids, start=1):
            yield frames[index].token, frame_file(grid, loaded.row.label_grid)
            progress("predict", done, len(in_order))

    write_files(plan.output, predicted())
    return loaded.written(plan.output, len(in_order))


@dataclass(frozen=True, eq=False)
class Predictor:
    """A model in evaluation, on a device."""

    model: OccupancyModel[Any]
    device: torch.device
    precision: str
    grid: LabelGrid = PAPER

    def classes(self, dataset: FrameDataset, index: int) -> NDArray[np.uint8]:
        """Return the classes of a frame in the grid's shape."""
        batch = moved(dataset[0, index], self.device)
        with torch.inference_mode():
            with torch.autocast(self.device.type, torch.bfloat16, enabled=self.precision == "bfloat16"):
                outputs = self.model(batch)
            classes = self.model.classes(outputs, batch)[0]
        whole = np.zeros(self.grid.shape, np.uint8)
        whole[grid_part(self.model.lattice, self.grid)] = classes.cpu().numpy()
        return whole


@dataclass(frozen=True, eq=False)
class LoadedRun:
    """A run for prediction: its row, its model with weights, and their origin."""

    row: RowConfig
    predictor: Predictor
    provenance: WeightsProvenance

    def require_grid(self, grid: LabelGrid) -> None:
        """Raise `grids_differ` if the requested grid differs from the row's."""
        if grid.geometry != self.row.label_grid.geometry:
            raise Refused(
                "grids_differ",
                f"the manifest requires {grid}, but the run was trained at {self.row.label_grid}; train a row whose "
                f"grid is {grid.name}",
            )

    def predicted(self, store: FrameStore, indices: Iterable[int]) -> Iterator[tuple[int, NDArray[np.uint8]]]:
        """Yield index and classes (grid's shape) of frames of the store; fastest in time order, as frames share sweeps.

        Raises what reading the store raises.
        """
        dataset = FrameDataset(
            store, FrameRequest(self.row.inputs, self.predictor.model.lattice, grid=self.row.label_grid)
        )
        return ((index, self.predictor.classes(dataset, index)) for index in indices)

    def written(self, output: Path, frames: int) -> WrittenPrediction:
        origin = (self.provenance.position.step, self.provenance.data_sha256)
        return WrittenPrediction(str(output), frames, self.row.method, self.row.inputs.modality, *origin)


def loaded_run(run: Path, device: str) -> LoadedRun:
    """Return the run's row and model. Raises `bad_run`, `bad_row`, `no_accelerator`."""
    row, own = read_run_row(run), usable_device(device)
    model = build_model(row.model).to(own)
    provenance = read_weights(run, model)
    return LoadedRun(row, Predictor(model.eval(), own, row.training.precision, row.label_grid), provenance)
