"""`stone label-sets`: list the label sets of a sequence, delete a label set, compare two label sets."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from stone_client.confirmation import DryRunOption, YesOption, require_confirmation, show_dry_run
from stone_client.options import SequenceArgument, ServerOption
from stone_client.progress import reported
from stone_client.streams import JsonOption, echo_json
from stone_client.tables import confusion_table, show

label_sets = typer.Typer(help="List, delete and compare the label sets of a sequence.", no_args_is_help=True)

FirstArgument = Annotated[
    str, typer.Argument(metavar="A", help="A folder that holds gts/; with --sequence an id, or latest, latest~1, …")
]
SecondArgument = Annotated[str, typer.Argument(metavar="B", help="Another of the same run.")]
SequenceOption = Annotated[
    str | None, typer.Option("--sequence", metavar="NAME", help="A sequence of the server, whose label sets are meant.")
]
PicturesOption = Annotated[
    Path | None,
    typer.Option("--pictures", metavar="DIR", file_okay=False, help="Write images of the least similar frames."),
]


@label_sets.command("list")
def listed(sequence: SequenceArgument, server: ServerOption = None, as_json: JsonOption = False) -> None:
    """Show all label sets of a sequence of the server, newest first, and which of them is active."""
    from stone_client.connection import connected
    from stone_client.server.label_sets import label_set_table, label_sets_of
    from stone_client.server.sequences import find_sequence

    with connected(server) as api:
        found = find_sequence(api, sequence)
        sets = label_sets_of(api, found["id"])
    if as_json:
        echo_json({"sequence": found["name"], "label_sets": sets})
        return
    show(label_set_table(found["name"], sets))


@label_sets.command()
def delete(
    sequence: SequenceArgument,
    label_set: Annotated[str, typer.Argument(metavar="LABEL_SET", help="An id, or latest, latest~1, …")],
    server: ServerOption = None,
    is_confirmed: YesOption = False,
    is_dry_run: DryRunOption = False,
    as_json: JsonOption = False,
) -> None:
    """Delete a label set and free its bytes; refused if an export, a version or a phase relies on the label set."""
    from stone_client.connection import connected
    from stone_client.server.label_sets import delete_label_set, deletion, label_set_named
    from stone_client.server.sequences import find_sequence

    with connected(server) as api:
        found = find_sequence(api, sequence)
        deleted = label_set_named(api, found, label_set)
        act = deletion(found, deleted)
        if is_dry_run:
            show_dry_run(act, {"label_set": deleted}, as_json=as_json)
            return
        require_confirmation(act, is_given=is_confirmed, moving="" if label_set == deleted else label_set)
        delete_label_set(api, found, deleted)
    if as_json:
        echo_json({"deleted": deleted})
        return
    typer.echo(f"deleted {deleted}")


@label_sets.command()
def compare(
    a: FirstArgument,
    b: SecondArgument,
    sequence: SequenceOption = None,
    pictures: PicturesOption = None,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Compare two label sets of one run: IoU, confusion, by distance; neither is ground truth."""
    if sequence is None and server is not None:
        raise typer.BadParameter("it is for a server's label sets, and needs --sequence", param_hint="--server")
    with reported() as progress:
        if sequence is None:
            record = _of_folders((Path(a), Path(b)), pictures, progress)
        else:
            record = _of_server((a, b), sequence, server, pictures, progress)
    if as_json:
        echo_json(record)
        return
    _show(record)


def _of_folders(folders: tuple[Path, Path], pictures: Path | None, progress: Any) -> dict[str, Any]:
    from services.eval.comparison.folders import compare_folders, open_folders, write_pictures

    opened = open_folders(*folders)
    record = compare_folders(opened, progress)
    written = write_pictures(opened, record, pictures) if pictures else []
    return {**record, "pictures": [os.fspath(path) for path in written]}


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
    from stone_local.agreement_tables import agreement_table, least_alike_table, ring_table

    show(agreement_table(record))
    show(confusion_table(record["all_voxels"]["confusion"], "A", "B"))
    show(ring_table(record["all_voxels"]["rings"]))
    if record["least_alike"]:
        show(least_alike_table(record["least_alike"]))
    for path in record["pictures"]:
        typer.echo(path)
