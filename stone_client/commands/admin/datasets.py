"""`stone admin datasets`: the inputs of a published version."""

from typing import Annotated

import typer

from stone_client.commands.admin import RequiredReason
from stone_client.commands.admin.phases import WaitOption
from stone_client.options import ServerOption
from stone_client.record_tables import echo_records
from stone_client.streams import JsonOption, echo_json

VersionArgument = Annotated[str, typer.Argument(metavar="VERSION", help="A version of the dataset.")]


def inputs(
    version: VersionArgument,
    reason: RequiredReason,
    is_awaited: WaitOption = True,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Create the missing inputs of a version's train and val, for training."""
    from urllib.parse import quote

    from stone_client.connection import administering
    from stone_client.server.admin.inputs import create_inputs

    named = quote(version, safe="")
    with administering(server) as api:
        made = create_inputs(api, f"/datasets/{named}", reason, is_awaited=is_awaited)
    if as_json:
        echo_json(made)
        return
    columns = {"sequence": "name", "split": "split", "state": "state", "bytes": "tar_bytes"}
    echo_records("inputs", made["inputs"], columns, as_json=False)
