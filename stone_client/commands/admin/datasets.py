"""`stone admin datasets`: the inputs of a published version."""

from typing import Annotated

import typer

from stone_client.commands.admin import RequiredReason
from stone_client.commands.admin.phases import WaitOption
from stone_client.options import ServerOption
from stone_client.progress import reported
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
    from stone_client.server.job_following import follow

    named = quote(version, safe="")
    with administering(server) as api:
        job = api.create(f"/admin/datasets/{named}/inputs", {"reason": reason})
        if is_awaited:
            with reported() as progress:
                job = dict(follow(api, job["id"], progress))
        made = list(api.pages(f"/datasets/{named}/inputs"))
    if as_json:
        echo_json({"job": job, "inputs": made})
        return
    columns = {"sequence": "name", "split": "split", "state": "state", "bytes": "tar_bytes"}
    echo_records("inputs", made, columns, as_json=False)
