"""`stone label-set compare`: compare two label sets of one run, on a server or in local folders."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from stone_client.options import ServerOption
from stone_client.platform_part import platform_module
from stone_client.progress import reported
from stone_client.streams import JsonOption, echo_json
from stone_client.tables import confusion_table, show

FirstArgument = Annotated[
    str, typer.Argument(metavar="A", help="A folder with gts/; with --sequence, a label set id or latest, latest~1, …")
]
SecondArgument = Annotated[str, typer.Argument(metavar="B", help="Another folder or label set of the same run.")]
SequenceOption = Annotated[
    str | None,
    typer.Option("--sequence", metavar="NAME", help="Compare two label sets of this sequence on the server."),
]
PicturesOption = Annotated[
    Path | None,
    typer.Option("--pictures", metavar="DIR", file_okay=False, help="Write images of the least similar frames."),
]


def compare(
    a: FirstArgument,
    b: SecondArgument,
    sequence: SequenceOption = None,
    pictures: PicturesOption = None,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Compare two label sets of one run: IoU, confusion, by distance; neither is ground truth.

    Comparing local folders requires the platform.
    """
    if sequence is None and server is not None:
        raise typer.BadParameter("it applies to label sets on a server and requires --sequence", param_hint="--server")
    if sequence is None:
        folders = platform_module("label_set_folders", "label-set compare")
        with reported() as progress:
            record = folders.compare((Path(a), Path(b)), pictures, progress)
    else:
        with reported() as progress:
            record = _of_server((a, b), sequence, server, pictures, progress)
    if as_json:
        echo_json(record)
        return
    _show(record)


def _of_server(
    named: tuple[str, str], sequence: str, server: str | None, pictures: Path | None, progress: Any
) -> dict[str, Any]:
    from stone_client.connection import connected
    from stone_client.server.label_sets import compare_label_sets, fetch_pictures
    from stone_client.server.sequences import find_sequence

    with connected(server) as api:
        made = compare_label_sets(api, find_sequence(api, sequence), named, progress)
        written = fetch_pictures(api, made, pictures) if pictures else []
    return {**made["record"], "pictures": [os.fspath(path) for path in written]}


def _show(record: Mapping[str, Any]) -> None:
    from stone_client.agreement_tables import agreement_table, least_alike_table, ring_table

    show(agreement_table(record))
    show(confusion_table(record["all_voxels"]["confusion"], "A", "B"))
    show(ring_table(record["all_voxels"]["rings"]))
    if record["least_alike"]:
        show(least_alike_table(record["least_alike"]))
    for path in record["pictures"]:
        typer.echo(path)
