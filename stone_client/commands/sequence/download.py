"""`stone sequence download`: download the labels of a sequence, or one of its exports as an archive."""

from pathlib import Path
from typing import Annotated, Any

import typer

from stone_client.commands.sequence.exports import Format
from stone_client.options import SequenceArgument, ServerOption
from stone_client.progress import reported, transferred
from stone_client.streams import JsonOption, echo_json

OutputOption = Annotated[
    Path,
    typer.Option(
        "-o",
        "--output",
        metavar="DIR|FILE",
        help="Folder: new, empty or an earlier label set to replace. For an export: a .tar or .zip file.",
    ),
]
FormatOption = Annotated[
    Format | None, typer.Option("--format", help="Download an export instead of labels; see `stone sequence exports`.")
]


def download(
    sequence: SequenceArgument,
    output: OutputOption,
    form: FormatOption = None,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Download labels, in the layout of `stone label`, or an export; an interrupted download resumes."""
    record = _labels(sequence, output, server) if form is None else _export(sequence, form, output, server)
    if as_json:
        echo_json(record)
    elif form is None:
        typer.echo(f"Labels: {output}\nPicture: {output / 'bev.png'}")
    else:
        typer.echo(f"{form.value}: {output} ({record['size_bytes']:,} bytes, sha256 {record['sha256']})")


def _labels(sequence: str, output: Path, server: str | None) -> dict[str, Any]:
    from stone_client.connection import connected
    from stone_client.files.label_download import download_labels
    from stone_client.server.sequences import find_sequence

    with connected(server) as api, reported() as progress:
        return download_labels(api, find_sequence(api, sequence), output, progress)


def _export(sequence: str, form: Format, output: Path, server: str | None) -> dict[str, Any]:
    from stone_client.connection import connected
    from stone_client.server.exports import ARCHIVES, download_archive, finished_export
    from stone_client.server.sequences import find_sequence

    if output.suffix[1:] not in ARCHIVES:
        raise typer.BadParameter(f"{output} is neither a .tar nor a .zip file", param_hint="--output")
    with connected(server) as api, transferred() as progress:
        export = finished_export(api, find_sequence(api, sequence), form.value)
        return download_archive(api, export, output, progress)
