"""`stone dataset list`, `show` and `download`: versions of the dataset."""

from pathlib import Path
from typing import Annotated, Any

import typer

from stone_client.options import ServerOption
from stone_client.streams import JsonOption, echo_json

VersionArgument = Annotated[str, typer.Argument(metavar="VERSION", help="A version's name.")]
OutputOption = Annotated[
    Path,
    typer.Option(
        "-o", "--output", metavar="DIR", file_okay=False, help="Output folder; an interrupted download resumes."
    ),
]
InputsOption = Annotated[bool, typer.Option("--inputs", help="Also download the sensor data, one tar per sequence.")]


def listed(server: ServerOption = None, as_json: JsonOption = False) -> None:
    """List the versions of the dataset."""
    from stone_client.connection import connected
    from stone_client.server.datasets import read_datasets

    with connected(server) as api:
        versions = read_datasets(api)
    _show({"datasets": versions}, as_json)


def show(version: VersionArgument, server: ServerOption = None, as_json: JsonOption = False) -> None:
    """Show a version of the dataset with its sequences."""
    from stone_client.connection import connected
    from stone_client.server.datasets import read_dataset

    with connected(server) as api:
        record = read_dataset(api, version)
    _show(record, as_json)


def download(
    version: VersionArgument,
    output: OutputOption,
    inputs: InputsOption = False,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Download the manifest, train and val of a version; an interrupted download resumes."""
    from stone_client.connection import connected
    from stone_client.progress import transferred
    from stone_client.server.datasets import download_dataset, download_dataset_inputs, read_dataset

    with connected(server) as api, transferred() as progress:
        record = read_dataset(api, version)
        record["files"] = download_dataset(api, record, output, progress)
        if inputs:
            record["inputs"] = download_dataset_inputs(api, record, output, progress)
    _show(record, as_json)


def _show(record: dict[str, Any], as_json: bool) -> None:
    from stone_client.server.datasets import show_datasets

    if as_json:
        echo_json(record)
    else:
        show_datasets(record)
