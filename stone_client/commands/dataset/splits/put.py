"""`stone dataset splits put`: replace the draft splits with the splits of a file."""

from pathlib import Path
from typing import Annotated

import typer

from stone_client.confirmation import DryRunOption, YesOption, require_confirmation, show_dry_run
from stone_client.options import ServerOption
from stone_client.refusals import REFUSED
from stone_client.streams import JsonOption, echo_json

FileArgument = Annotated[
    Path,
    typer.Argument(
        metavar="FILE", exists=True, dir_okay=False, help="A JSON file of splits, as `splits propose --json` prints it."
    ),
]
ReasonOption = Annotated[str, typer.Option(metavar="TEXT", help="Reason, recorded in the audit log.")]


def put(
    file: FileArgument,
    reason: ReasonOption = "put by the stone command",
    is_confirmed: YesOption = False,
    is_dry_run: DryRunOption = False,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Save the splits of a file as the draft, replacing the current draft."""
    from stone_client.connection import connected
    from stone_client.server.publication import planned_splits, saving, show_splits_plan
    from stone_client.server.splits import put_file, show_splits

    with connected(server) as api:
        shown_revision = None
        if is_dry_run or not is_confirmed:
            plan = planned_splits(api, file)
            show_splits_plan(plan, as_json=as_json)
            if is_dry_run:
                show_dry_run(saving(plan), plan, as_json=as_json)
                raise typer.Exit(0 if plan["can_be_put"] else REFUSED)
            require_confirmation(saving(plan), is_given=False)
            shown_revision = plan["revision"]
        record = put_file(api, file, reason, shown_revision)
    if as_json:
        echo_json(record)
    show_splits(record, as_json=as_json)
