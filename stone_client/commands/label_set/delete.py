"""`stone label-set delete`: delete a label set from a server."""

from typing import Annotated

import typer

from stone_client.confirmation import DryRunOption, YesOption, confirm
from stone_client.options import SequenceArgument, ServerOption
from stone_client.streams import JsonOption, echo_json

LabelSetArgument = Annotated[
    str, typer.Argument(metavar="LABEL_SET", help="Six or more digits of its id, or latest, latest~1, …")
]


def delete(
    sequence: SequenceArgument,
    label_set: LabelSetArgument,
    server: ServerOption = None,
    is_confirmed: YesOption = False,
    is_dry_run: DryRunOption = False,
    as_json: JsonOption = False,
) -> None:
    """Delete a label set and free its storage; refused if an export, a version or a phase uses the label set."""
    from stone_client.connection import connected
    from stone_client.server.label_sets import delete_label_set, deletion, label_set_named
    from stone_client.server.sequences import find_sequence

    with connected(server) as api:
        item = find_sequence(api, sequence)
        deleted = label_set_named(api, item, label_set)
        act = deletion(item, deleted)
        confirm(
            act, {"label_set": deleted}, is_given=is_confirmed, is_dry_run=is_dry_run, as_json=as_json, named=label_set
        )
        delete_label_set(api, item, deleted)
    if as_json:
        echo_json({"deleted": deleted})
        return
    typer.echo(f"deleted {deleted}")
