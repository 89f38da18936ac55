"""`stone model train`: train a row of the benchmark on exported data."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from stone_client.progress import reported
from stone_client.streams import JsonOption, echo_json, echo_notice
from stone_local.models.torch_there import torch_needed
from stone_local.models.training_progress import training_shown


class Device(StrEnum):
    """The devices for the network."""

    CPU = "cpu"
    CUDA = "cuda"


class Precision(StrEnum):
    """The precisions of the network; geometry and losses are always float32."""

    FLOAT32 = "float32"
    BFLOAT16 = "bfloat16"


THE_ROWS = "the row's"

RowArgument = Annotated[str, typer.Argument(metavar="ROW", help="Name of a row (docs/train.md), or its YAML file.")]
ExportsArgument = Annotated[
    list[Path],
    typer.Argument(
        metavar="EXPORTS...",
        exists=True,
        help="Exports of format nuscenes, or inputs beside the tars of a dataset version (folders or tars), or a "
        "published ZIP. Manifests among them select frames.",
    ),
]
RunOption = Annotated[Path, typer.Option("-o", "--output", metavar="RUN", file_okay=False, help="Folder of the run.")]
WatchOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--watch",
        metavar="EXPORTS",
        exists=True,
        help="Validation data as EXPORTS, scored after each epoch; repeatable.",
    ),
]
ResumeOption = Annotated[bool, typer.Option("--resume", help="Resume from the run's checkpoint.")]
DeviceOption = Annotated[Device, typer.Option(help="Device.")]
EpochsOption = Annotated[int | None, typer.Option(min=1, max=10_000, show_default=THE_ROWS, help="Number of epochs.")]
BatchOption = Annotated[int | None, typer.Option(min=1, max=256, show_default=THE_ROWS, help="Batch size in frames.")]
AccumulateOption = Annotated[
    int | None,
    typer.Option(min=1, max=1024, show_default=THE_ROWS, help="Batches per optimiser step (gradient accumulation)."),
]
RateOption = Annotated[
    float | None, typer.Option("--learning-rate", min=0.0, show_default=THE_ROWS, help="Peak learning rate.")
]
StrideOption = Annotated[
    int | None, typer.Option(min=1, show_default=THE_ROWS, help="Train on every n-th frame of a sequence.")
]
LeastConfidenceOption = Annotated[
    float | None,
    typer.Option(
        "--least-confidence",
        min=0.0,
        max=1.0,
        show_default=THE_ROWS,
        help="Losses ignore occupied voxels with a lower label confidence.",
    ),
]
SeedOption = Annotated[
    int | None, typer.Option(min=0, show_default=THE_ROWS, help="Seed of weights, order and augmentation.")
]
PrecisionOption = Annotated[Precision | None, typer.Option(show_default=THE_ROWS, help="Precision of the network.")]
BackboneOption = Annotated[
    Path | None,
    typer.Option(
        "--backbone", metavar="FILE", exists=True, dir_okay=False, help="Image weights, by torchvision's names."
    ),
]
CacheOption = Annotated[
    Path | None,
    typer.Option("--cache", metavar="DIR", file_okay=False, help="Cache folder for read frames, shared by runs."),
]
LoadersOption = Annotated[int, typer.Option(min=0, max=64, help="Number of processes that read frames.")]
CheckpointOption = Annotated[
    int | None,
    typer.Option("--checkpoint-steps", min=1, show_default=THE_ROWS, help="Number of steps between checkpoints."),
]

GradientsOption = Annotated[
    bool, typer.Option("--checkpoint-gradients", help="Gradient checkpointing: less memory, more time.")
]


def train(
    row: RowArgument,
    exports: ExportsArgument,
    output: RunOption,
    watch: WatchOption = None,
    resume: ResumeOption = False,
    device: DeviceOption = Device.CPU,
    epochs: EpochsOption = None,
    batch: BatchOption = None,
    accumulate: AccumulateOption = None,
    learning_rate: RateOption = None,
    stride: StrideOption = None,
    least_confidence: LeastConfidenceOption = None,
    seed: SeedOption = None,
    precision: PrecisionOption = None,
    backbone: BackboneOption = None,
    cache: CacheOption = None,
    loaders: LoadersOption = 0,
    checkpoint_gradients: GradientsOption = False,
    checkpoint_steps: CheckpointOption = None,
    as_json: JsonOption = False,
) -> None:
    """Train a row on exported frames; an interrupted run continues with --resume. Requires torch: `make baselines`."""
    with torch_needed():
        from baselines.row_config import read_row, with_checkpointed_gradients
        from baselines.train import TrainingPlan
        from baselines.train import train as trained
    changes: dict[str, Any] = {
        "epochs": epochs, "batch": batch, "accumulate": accumulate, "learning_rate": learning_rate, "stride": stride,
        "least_confidence": least_confidence, "seed": seed, "checkpoint_steps": checkpoint_steps,
        "precision": None if precision is None else precision.value,
    }  # fmt: skip
    config = read_row(row, changes)
    if checkpoint_gradients:
        config = with_checkpointed_gradients(config)
    sources = tuple(exports), output, tuple(watch or ()), resume
    plan = TrainingPlan(config, *sources, device.value, cache, backbone, loaders)
    with reported() as progress, training_shown() as reports:
        ended = trained(plan, progress, reports)
    if as_json:
        echo_json(ended.__dict__)
        return
    typer.echo(f"{output}: {ended.steps:,} steps on {ended.frames:,} frames (sha256 {ended.data_sha256[:16]}…)")
    if ended.best_miou is not None:
        typer.echo(f"best validation mIoU: {100 * ended.best_miou:.2f} %")
    echo_notice(f"Next: stone model predict {output} INPUTS --manifest M.json -o sub.zip")
