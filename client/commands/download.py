"""`stone download`: the labels of a sequence from a server."""

from pathlib import Path
from typing import Annotated

import typer

from client.inputs import SequenceArgument, ServerOption
from client.progress import reported
from client.streams import JsonOption, echo_json

OutputOption = Annotated[
    Path, typer.Option("-o", "--output", metavar="DIR", help="New or empty, or an earlier label set to replace.")
]


def download(
    sequence: SequenceArgument, output: OutputOption, server: ServerOption = None, as_json: JsonOption = False
) -> None:
    """Fetch report, picture, mesh, frame table and every frame's labels, laid out as `stone label` does."""
    from client.connecting import connected
    from client.downloading import download_labels
    from client.remote import find_sequence

    with connected(server) as api, reported() as progress:
        record = download_labels(api, find_sequence(api, sequence), output, progress)
    if as_json:
        echo_json(record)
    else:
        typer.echo(f"Labels: {output}\nPicture: {output / 'bev.png'}")
