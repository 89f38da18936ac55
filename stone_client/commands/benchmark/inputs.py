"""`stone benchmark inputs`: download the sensor data of a phase's sequences."""

from pathlib import Path
from typing import Annotated

import typer

from stone_client.options import BenchmarkArgument, PhaseArgument, ServerOption
from stone_client.progress import transferred
from stone_client.streams import JsonOption, echo_json

OutputOption = Annotated[
    Path, typer.Option("-o", "--output", metavar="DIR", file_okay=False, help="Output folder, one tar per sequence.")
]


def inputs(
    benchmark: BenchmarkArgument,
    phase: PhaseArgument,
    output: OutputOption,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Download the inputs of a phase: nuScenes tables and samples, without labels; resumes if interrupted."""
    from stone_client.connection import connected
    from stone_client.server.benchmarks import download_inputs

    with connected(server) as api, transferred() as progress:
        files = download_inputs(api, (benchmark, phase), output, progress)
    if as_json:
        echo_json({"inputs": files})
        return
    for file in files:
        typer.echo(f"{file['output']} ({file['size_bytes']:,} bytes, sha256 {file['sha256']})")
    if not files:
        typer.echo("there are no inputs yet; the organiser creates them", err=True)
