"""CPU-seconds per frame of a recording with torch and onnxruntime: `python -m benchmarks.models.speed`.

    python -m benchmarks.models.speed column-net RUN --bag BAG --calibration CAL

A row is a run, or a shipped row, untrained: ColumnNet's cost does not depend on training, CoNet's on the number of
voxels predicted occupied. One thread; CPU-seconds, so that other load matters little; the median of all frames except
the first, which also reads earlier frames. `read` is from the recording to the batch, `whole` the model and its classes
in torch. For ColumnNet, `geometry` is the part before its network, `network` the network in torch, `onnx` the network
in onnxruntime.
"""

import argparse
import statistics
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time

import torch
from rich.console import Console
from rich.table import Table

from baselines.batch import Batch
from baselines.checkpoint import WeightsProvenance, write_weights
from baselines.data import FrameDataset, FrameRequest
from baselines.models.architectures import build_model
from baselines.models.column_net import ColumnNet
from baselines.models.column_net_program import ColumnNetProgram, inputs_of
from baselines.onnx_export import write_onnx
from baselines.predict import LoadedRun, loaded_run
from baselines.row_config import read_row
from baselines.run_folder import write_run_row
from services.ingest.pipeline import SynchroniseOptions
from services.ingest.sequence import open_sequence
from stone_local.models.recording_prediction import RecordedStore
from stone_recordings.sync.samples import BagSamples

PARTS = ("read", "whole", "geometry", "network", "onnx")
Feed = dict[str, torch.Tensor]


@dataclass
class FrameCosts:
    """CPU-seconds of each frame by part, and the share of voxels with equal classes in onnxruntime and torch."""

    seconds: dict[str, list[float]] = field(default_factory=lambda: {part: [] for part in PARTS})
    equal: list[float] = field(default_factory=list)

    @contextmanager
    def of(self, part: str) -> Iterator[None]:
        begun = process_time()
        yield
        self.seconds[part].append(process_time() - begun)

    def median(self, part: str) -> str:
        return f"{statistics.median(self.seconds[part][1:]):.2f}" if self.seconds[part] else "—"


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("rows", nargs="+")
    arguments.add_argument("--bag", type=Path, required=True)
    arguments.add_argument("--calibration", type=Path, required=True)
    arguments.add_argument("--frames", type=int, default=4)
    options = arguments.parse_args()
    torch.set_num_threads(1)
    sequence, _ = open_sequence(options.bag, options.calibration, "speed", SynchroniseOptions(is_hashed=False))
    table = Table("row", *(f"{part}, CPU-s" for part in PARTS), "argmax equal")
    with TemporaryDirectory() as folder:
        for number, name in enumerate(options.rows):
            run = Path(name) if Path(name).is_dir() else untrained_run(name, Path(folder) / str(number))
            loaded = loaded_run(run, "cpu")
            store = RecordedStore(sequence, BagSamples(options.bag, sequence), loaded.row.inputs)
            costs = frame_costs(loaded, store, range(4, 5 + options.frames), onnx_of(run, loaded))
            equal = f"{min(costs.equal):.6f}" if costs.equal else "—"
            table.add_row(loaded.row.name, *(costs.median(part) for part in PARTS), equal)
    Console(width=140).print(table)


def untrained_run(row: str, folder: Path) -> Path:
    """Return a run of this shipped row with its initial weights."""
    config = read_row(row)
    write_run_row(folder, config)
    torch.manual_seed(0)
    write_weights(folder, build_model(config.model), WeightsProvenance(config.as_json(), "untrained", "none", 0))
    return folder


def onnx_of(run: Path, loaded: LoadedRun) -> Callable[[Feed], torch.Tensor] | None:
    """Return the function that computes logits by onnxruntime; None if the row cannot be exported."""
    if not isinstance(loaded.predictor.model, ColumnNet):
        return None
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    write_onnx(run, run / "model.onnx")
    session = onnxruntime.InferenceSession(run / "model.onnx", options, providers=["CPUExecutionProvider"])
    return lambda feed: torch.from_numpy(
        session.run(["logits"], {name: each.numpy() for name, each in feed.items()})[0]
    )


def frame_costs(
    loaded: LoadedRun, store: RecordedStore, indices: range, onnx: Callable[[Feed], torch.Tensor] | None
) -> FrameCosts:
    """Return the costs of the frames at `indices`; the first frame warms up."""
    model, costs = loaded.predictor.model, FrameCosts()
    dataset = FrameDataset(store, FrameRequest(loaded.row.inputs, model.lattice))
    with torch.inference_mode():
        for index in indices:
            with costs.of("read"):
                batch = dataset[0, index]
            with costs.of("whole"):
                model.classes(model(batch), batch)
            if isinstance(model, ColumnNet) and onnx is not None:
                _add_parts(model, batch, onnx, costs)
    return costs


def _add_parts(model: ColumnNet, batch: Batch, onnx: Callable[[Feed], torch.Tensor], costs: FrameCosts) -> None:
    with costs.of("geometry"):
        feed = inputs_of(model, batch)
    program = ColumnNetProgram(model)
    with costs.of("network"):
        logits, _ = program(*feed.values())
    with costs.of("onnx"):
        answered = onnx(feed)
    costs.equal.append(float((answered.argmax(1) == logits.argmax(1)).double().mean()))


if __name__ == "__main__":
    main()
