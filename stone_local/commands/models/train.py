"""`stone train`: a row of the benchmark, trained on exported data."""

from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from stone_client.commands.benchmark.submit import submit as send_submission
from stone_client.files.bags import called
from stone_client.options import Ground, GroundOption, LidarOption, Modality, OdometryOption, ServerOption
from stone_client.progress import reported
from stone_client.streams import JsonOption, echo_json
from stone_local.models.prediction_choices import RecordingFiles, refuse_contradictions
from stone_local.models.recording_prediction import prediction_shown
from stone_local.models.torch_there import torch_needed
from stone_local.models.training_progress import training_shown
from stone_local.topic_choices import (
    PosesFrameOption,
    PosesOption,
    TimeOffsetOption,
    TopicOption,
    TopicsOption,
    chosen_offsets,
    chosen_poses,
    chosen_topics,
)


class Device(StrEnum):
    """Where a network is computed."""

    CPU = "cpu"
    CUDA = "cuda"


class Precision(StrEnum):
    """Of the network; geometry and losses are float32 always."""

    FLOAT32 = "float32"
    BFLOAT16 = "bfloat16"


THE_ROWS = "the row's"

RowArgument = Annotated[
    str, typer.Argument(metavar="ROW", help="A row's name (docs/models.md), or a YAML file of one.")
]
ExportsArgument = Annotated[
    list[Path],
    typer.Argument(
        metavar="EXPORTS...",
        exists=True,
        help="Exports of format nuscenes, or inputs beside the tars of a dataset version; folders or tars.",
    ),
]
RunOption = Annotated[
    Path, typer.Option("-o", "--output", metavar="RUN", file_okay=False, help="The folder of the run.")
]
WatchOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--watch", metavar="EXPORTS", exists=True, help="Validation data, scored after each epoch; repeatable."
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
SeedOption = Annotated[
    int | None, typer.Option(min=0, show_default=THE_ROWS, help="Seed of weights, order and augmentation.")
]
PrecisionOption = Annotated[Precision | None, typer.Option(show_default=THE_ROWS, help="Of the network.")]
BackboneOption = Annotated[
    Path | None,
    typer.Option("--backbone", metavar="FILE", exists=True, dir_okay=False, help="Image weights, torchvision's names."),
]
CacheOption = Annotated[
    Path | None,
    typer.Option("--cache", metavar="DIR", file_okay=False, help="Cache folder for read frames, shared by runs."),
]
LoadersOption = Annotated[int, typer.Option(min=0, max=64, help="Processes that read frames beside the training.")]
CheckpointOption = Annotated[
    int | None, typer.Option("--checkpoint-steps", min=1, show_default=THE_ROWS, help="Steps between checkpoints.")
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
    seed: SeedOption = None,
    precision: PrecisionOption = None,
    backbone: BackboneOption = None,
    cache: CacheOption = None,
    loaders: LoadersOption = 0,
    checkpoint_gradients: GradientsOption = False,
    checkpoint_steps: CheckpointOption = None,
    as_json: JsonOption = False,
) -> None:
    """Train a row on exported frames; an interrupted run continues with --resume. Needs torch: `make baselines`."""
    with torch_needed():
        from baselines.row_config import read_row, with_checkpointed_gradients
        from baselines.train import TrainingPlan
        from baselines.train import train as trained
    changes: dict[str, Any] = {
        "epochs": epochs, "batch": batch, "accumulate": accumulate, "learning_rate": learning_rate, "stride": stride,
        "seed": seed, "precision": None if precision is None else precision.value, "checkpoint_steps": checkpoint_steps,
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
    typer.echo(f"Next: stone predict {output} INPUTS --manifest M.json -o sub.zip")


# `stone predict`: a submission by a trained row, and on to a board; or classes of a recording, frame by frame.


RunArgument = Annotated[
    Path, typer.Argument(metavar="RUN", exists=True, file_okay=False, help="The folder of a run of `stone train`.")
]
InputsArgument = Annotated[
    list[Path] | None,
    typer.Argument(metavar="[INPUTS...]", exists=True, help="Exports of format inputs or nuscenes; folders or tars."),
]
SomeManifestOption = Annotated[
    Path | None,
    typer.Option("--manifest", metavar="M.json", exists=True, dir_okay=False, help="The frames to predict."),
]
OutputOption = Annotated[
    Path,
    typer.Option(
        "-o", "--output", metavar="OUT", help="The submission; of a recording without a manifest, a folder of frames."
    ),
]
BagOption = Annotated[
    Path | None,
    typer.Option("--bag", metavar="BAG", exists=True, help="Predict a recording, frame by frame, instead of exports."),
]
OfBagOption = Annotated[
    Path | None,
    typer.Option("--calibration", metavar="CAL", exists=True, help="With --bag: the calibration of its sensors."),
]
SequenceOption = Annotated[
    str | None,
    typer.Option(metavar="NAME", show_default="the bag's", help="With --bag: the sequence's name, for frame tokens."),
]
SubmitOption = Annotated[bool, typer.Option("--submit", help="Send it to --benchmark, --phase, as --team.")]
BenchmarkOption = Annotated[str | None, typer.Option("--benchmark", metavar="B", help="With --submit: where to.")]
PhaseOption = Annotated[str | None, typer.Option("--phase", metavar="P", help="With --submit: a phase of it.")]
TeamOption = Annotated[str | None, typer.Option("--team", metavar="TEAM", help="With --submit: a team of yours.")]
MethodOption = Annotated[
    str | None, typer.Option(metavar="NAME", show_default="the row's", help="With --submit: its name on the board.")
]


def predict(
    run: RunArgument,
    output: OutputOption,
    inputs: InputsArgument = None,
    manifest: SomeManifestOption = None,
    device: DeviceOption = Device.CPU,
    bag: BagOption = None,
    calibration: OfBagOption = None,
    sequence: SequenceOption = None,
    odometry: OdometryOption = None,
    lidar: LidarOption = None,
    topics: TopicsOption = None,
    topic: TopicOption = [],  # noqa: B006
    ground: GroundOption = Ground.GIVEN,
    time_offset: TimeOffsetOption = [],  # noqa: B006
    poses: PosesOption = None,
    poses_frame: PosesFrameOption = "",
    submit: SubmitOption = False,
    benchmark: BenchmarkOption = None,
    phase: PhaseOption = None,
    team: TeamOption = None,
    method: MethodOption = None,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Predict each frame of a manifest or of a recording by a trained row, from that frame and earlier ones. Needs
    torch.
    """
    of_bags = {
        "--calibration": calibration, "--sequence": sequence, "--odometry": odometry, "--lidar": lidar,
        "--topics": topics, "--topic": topic, "--ground": ground is not Ground.GIVEN, "--time-offset": time_offset,
        "--poses": poses, "--poses-frame": poses_frame,
    }  # fmt: skip
    refuse_contradictions(inputs, bag, of_bags)
    if submit and (benchmark is None or phase is None or team is None or manifest is None):
        raise typer.BadParameter("it also needs --manifest, --benchmark, --phase and --team", param_hint="--submit")
    if bag is None or calibration is None:
        written = _of_exports(run, inputs or [], (manifest, output), device)
    else:
        sources = {
            "odometry_topic": odometry, "lidar_topic": lidar, "topics": chosen_topics(topics, topic).topics,
            "ground": ground.value, "time_offsets_ns": chosen_offsets(time_offset),
            "poses": chosen_poses(poses, poses_frame, odometry), "poses_frame": poses_frame,
        }  # fmt: skip
        files = RecordingFiles(bag, calibration, sequence or called(bag))
        written = _of_recording(run, files, (manifest, output), (sources, device))
    if submit and benchmark is not None and phase is not None and team is not None:
        named, modality = method or written["method"], Modality(written["modality"])
        send_submission(output, benchmark, phase, team, named, modality, server=server, as_json=as_json)
    elif as_json:
        echo_json(written)
    else:
        typer.echo(f"{output}: {written['frames']:,} frames by {written['method']} after {written['steps']:,} steps")
        if manifest is not None:
            typer.echo(f"Next: stone validate {output} --manifest {manifest}")


def _of_exports(run: Path, inputs: list[Path], files: tuple[Path | None, Path], device: Device) -> dict[str, Any]:
    manifest, output = files
    if manifest is None:
        raise typer.BadParameter("INPUTS need it: it says which of their frames to predict", param_hint="--manifest")
    with torch_needed():
        from baselines.predict import PredictionPlan
        from baselines.predict import predict as predicted
    with reported() as progress:
        return asdict(predicted(PredictionPlan(run, tuple(inputs), manifest, output, device.value), progress))


def _of_recording(
    run: Path, recording: RecordingFiles, files: tuple[Path | None, Path], how: tuple[dict[str, Any], Device]
) -> dict[str, Any]:
    with torch_needed():
        from baselines.predict import loaded_run
    from services.ingest.pipeline import SynchroniseOptions
    from services.ingest.sequence import open_sequence
    from stone_local.models.recording_prediction import RecordingPlan, predict_recording

    (manifest, output), (sources, device) = files, how
    loaded = loaded_run(run, device.value)
    with reported() as progress:
        options = SynchroniseOptions(is_hashed=False, progress=progress, **sources)
        sequence, _ = open_sequence(recording.bag, recording.calibration, recording.name, options)
    with prediction_shown() as paces:
        return asdict(predict_recording(loaded, RecordingPlan(recording.bag, sequence, output, manifest), paces))


# `stone onnx`: a trained network as one file for a robot's own runtime.


OnnxOption = Annotated[
    Path, typer.Option("-o", "--output", metavar="MODEL.onnx", dir_okay=False, help="The file to write.")
]


def onnx(run: RunArgument, output: OnnxOption, as_json: JsonOption = False) -> None:
    """Write the network of a ColumnNet run as ONNX: all learned layers, after points are sorted into columns. Needs
    torch.
    """
    with torch_needed():
        from baselines.onnx_export import write_onnx

        written = write_onnx(run, output)  # the exporter looks for its libraries when it runs
    if as_json:
        echo_json(asdict(written))
        return
    typer.echo(f"{output}: {written.size_bytes:,} bytes, {written.method} after {written.steps:,} steps")
    for name, shape in written.inputs.items():
        typer.echo(f"  {name} {' × '.join(map(str, shape))}")
