"""`stone predict`: a submission by a trained row, and on to a board."""

from pathlib import Path
from typing import Annotated

import typer

from stone_client.commands.benchmark.submit import submit as send_submission
from stone_client.commands.models.train import Device, DeviceOption
from stone_client.models.torch_there import torch_needed
from stone_client.options import ManifestOption, Modality, ServerOption
from stone_client.progress import reported
from stone_client.streams import JsonOption, echo_json

RunArgument = Annotated[
    Path, typer.Argument(metavar="RUN", exists=True, file_okay=False, help="The folder of a run of `stone train`.")
]
InputsArgument = Annotated[
    list[Path],
    typer.Argument(metavar="INPUTS...", exists=True, help="Exports of format inputs or nuscenes; folders or tars."),
]
OutputOption = Annotated[
    Path, typer.Option("-o", "--output", metavar="SUB.zip", dir_okay=False, help="The submission.")
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
    inputs: InputsArgument,
    manifest: ManifestOption,
    output: OutputOption,
    device: DeviceOption = Device.CPU,
    submit: SubmitOption = False,
    benchmark: BenchmarkOption = None,
    phase: PhaseOption = None,
    team: TeamOption = None,
    method: MethodOption = None,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Predict each frame of a manifest by a trained row, from that frame and earlier ones. Needs torch."""
    if submit and (benchmark is None or phase is None or team is None):
        raise typer.BadParameter("it also needs --benchmark, --phase and --team", param_hint="--submit")
    with torch_needed():
        from baselines.predict import PredictionPlan
        from baselines.predict import predict as predicted
    with reported() as progress:
        written = predicted(PredictionPlan(run, tuple(inputs), manifest, output, device.value), progress)
    if submit and benchmark is not None and phase is not None and team is not None:
        named = method or written.method
        modality = Modality(written.modality)
        send_submission(output, benchmark, phase, team, named, modality, server=server, as_json=as_json)
    elif as_json:
        echo_json(written.__dict__)
    else:
        typer.echo(f"{output}: {written.frames:,} frames by {written.method} after {written.steps:,} steps")
        typer.echo(f"Next: stone validate {output} --manifest {manifest}")
