"""`stone demo`: the whole way once, on a simulated robot."""

from pathlib import Path
from typing import Annotated

import typer

from client.inputs import WorkersOption, cores
from client.progress import reported
from client.streams import JsonOption, echo_findings, echo_json
from client.tables import class_table, score_table, show
from simulator.options import SimulateOptions
from stone.findings import Finding

OutputOption = Annotated[
    Path, typer.Option("-o", "--output", metavar="DIR", help="New or empty, or an earlier demo to replace.")
]
SecondsOption = Annotated[float, typer.Option(min=2.0, max=600.0, help="How long the simulated robot drives.")]


def demo(
    output: OutputOption = Path("demo"),
    seconds: SecondsOption = 20.0,
    workers: WorkersOption = None,
    as_json: JsonOption = False,
) -> None:
    """Simulate a robot, label its recording, predict from single sweeps, score the prediction."""
    from client.demo import DemoPlan, run_demo

    with reported() as progress:
        record = run_demo(output, DemoPlan(SimulateOptions(seconds=seconds), workers or cores()), progress)
    if as_json:
        echo_json(record)
    else:
        labels = record["labels"]
        show(class_table(f"{labels['frames']} frames labelled: occupied voxels", labels["class_share_of_occupied"]))
        show(score_table(record["baseline"], "Prediction from single sweeps against these labels"))
        typer.echo(f"Everything: {output}\nPicture: {output / 'labels' / 'bev.png'}")
    echo_findings(Finding(**finding) for finding in record["labels"]["findings"])
