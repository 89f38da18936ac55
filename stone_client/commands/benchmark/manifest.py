"""`stone benchmark manifest`: the frames that a submission to a phase must contain."""

from pathlib import Path
from typing import Annotated

import typer

from stone_base.counts import counted
from stone_client.choices import in_folder
from stone_client.options import BenchmarkArgument, PhaseArgument, ServerOption
from stone_client.streams import JsonOption, echo_json

OutputOption = Annotated[
    Path, typer.Option("-o", "--output", metavar="M.json", dir_okay=False, callback=in_folder, help="Output file.")
]


def manifest(
    benchmark: BenchmarkArgument,
    phase: PhaseArgument,
    output: OutputOption,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Write the manifest of a phase, for `stone validate` and `stone baseline`."""
    from stone_client.connection import connected
    from stone_client.server.benchmarks import fetch_manifest
    from stone_submissions.manifest import read_manifest

    with connected(server) as api:
        written = fetch_manifest(api, (benchmark, phase), output)
    read = read_manifest(output)
    record = {**written, "frames": len(read.tokens), "sequences": len(read.sequences)}
    if as_json:
        echo_json(record)
    else:
        typer.echo(f"{output}: {counted(record['frames'], 'frame')} of {counted(record['sequences'], 'sequence')}")
