"""`stone model onnx`: a trained network as one file for a robot's own runtime."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from stone_client.choices import in_folder
from stone_client.streams import JsonOption, echo_json
from stone_local.commands.models.predict import RunArgument
from stone_local.models.torch_there import torch_needed

OutputOption = Annotated[
    Path,
    typer.Option("-o", "--output", metavar="MODEL.onnx", dir_okay=False, callback=in_folder, help="Output file."),
]


def onnx(run: RunArgument, output: OutputOption, as_json: JsonOption = False) -> None:
    """Write the network of a ColumnNet run as ONNX: all learned layers, after points are sorted into columns. Requires
    torch.
    """
    with torch_needed():
        from baselines.onnx_export import write_onnx

        written = write_onnx(run, output)  # the exporter imports its libraries only when it runs
    if as_json:
        echo_json(asdict(written))
        return
    typer.echo(f"{output}: {written.size_bytes:,} bytes, {written.method} after {written.steps:,} steps")
    for name, shape in written.inputs.items():
        typer.echo(f"  {name} {' × '.join(map(str, shape))}")
