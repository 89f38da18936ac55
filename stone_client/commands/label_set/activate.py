"""`stone label-set activate`: choose the label set that pages, exports and new versions use."""

from typing import Annotated

import typer

from stone_base.errors import one_line
from stone_client.options import SequenceArgument, ServerOption
from stone_client.streams import JsonOption, echo_json

LabelSetArgument = Annotated[
    str, typer.Argument(metavar="LABEL_SET", help="Six or more digits of its id, or latest, latest~1, …")
]


def activate(
    sequence: SequenceArgument, label_set: LabelSetArgument, server: ServerOption = None, as_json: JsonOption = False
) -> None:
    """Make a label set the active label set of its sequence, for pages, exports and new versions."""
    from stone_client.connection import connected
    from stone_client.server.label_sets import label_set_named
    from stone_client.server.sequences import find_sequence

    with connected(server) as api:
        item = find_sequence(api, sequence)
        path = f"/sequences/{item['id']}/label-sets/{label_set_named(api, item, label_set)}/activate"
        record = api.send("POST", path).json()
    if as_json:
        echo_json(record)
    else:
        typer.echo(one_line(f"active label set of {item['name']}: {record['id']}"))
