"""`stone model predict`: predict exports or a recording with a trained row."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from stone_client.choices import refuse_options
from stone_client.commands.benchmark.submit import submit as send_submission
from stone_client.files.bags import called
from stone_client.options import Ground, GroundOption, LidarOption, Modality, OdometryOption, ServerOption
from stone_client.progress import reported
from stone_client.streams import JsonOption, echo_json, echo_notice
from stone_local.commands.models.train import Device, DeviceOption
from stone_local.models.prediction_choices import RecordingFiles, refuse_contradictions
from stone_local.models.prediction_pace import prediction_shown
from stone_local.models.torch_there import torch_needed
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

RunArgument = Annotated[
    Path,
    typer.Argument(metavar="RUN", exists=True, file_okay=False, help="Run folder of `stone model train`."),
]
InputsArgument = Annotated[
    list[Path] | None,
    typer.Argument(
        metavar="[INPUTS...]", exists=True, help="Exports of format inputs or nuscenes (folders or tars), or a ZIP."
    ),
]
SomeManifestOption = Annotated[
    Path | None,
    typer.Option("--manifest", metavar="M.json", exists=True, dir_okay=False, help="Manifest of the frames."),
]
OutputOption = Annotated[
    Path,
    typer.Option("-o", "--output", metavar="OUT", help="Output zip; for a recording without a manifest, a folder."),
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
SubmitOption = Annotated[bool, typer.Option("--submit", help="Submit to --benchmark and --phase as --team.")]
BenchmarkOption = Annotated[str | None, typer.Option("--benchmark", metavar="B", help="With --submit: the benchmark.")]
PhaseOption = Annotated[str | None, typer.Option("--phase", metavar="P", help="With --submit: its phase.")]
TeamOption = Annotated[str | None, typer.Option("--team", metavar="TEAM", help="With --submit: one of your teams.")]
MethodOption = Annotated[
    str | None, typer.Option(metavar="NAME", show_default="the row's", help="With --submit: the name on the board.")
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
    """Predict each frame of a manifest or of a recording with a trained row, from that frame and earlier ones. Requires
    torch.
    """
    of_bags = {
        "--calibration": calibration, "--sequence": sequence, "--odometry": odometry, "--lidar": lidar,
        "--topics": topics, "--topic": topic, "--ground": ground is not Ground.GIVEN, "--time-offset": time_offset,
        "--poses": poses, "--poses-frame": poses_frame,
    }  # fmt: skip
    refuse_contradictions(inputs, bag, of_bags)
    if submit and (benchmark is None or phase is None or team is None or manifest is None):
        raise typer.BadParameter("it also requires --manifest, --benchmark, --phase and --team", param_hint="--submit")
    if not submit:
        to_board = {"--benchmark": benchmark, "--phase": phase, "--team": team, "--method": method, "--server": server}
        refuse_options("it requires --submit", to_board)
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
            echo_notice(f"Next: stone validate {output} --manifest {manifest}")


def _of_exports(run: Path, inputs: list[Path], files: tuple[Path | None, Path], device: Device) -> dict[str, Any]:
    manifest, output = files
    if manifest is None:
        raise typer.BadParameter("INPUTS require a manifest of the frames to predict", param_hint="--manifest")
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
