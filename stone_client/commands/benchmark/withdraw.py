"""`stone benchmark withdraw`: withdraw a submission from every board."""

from typing import Annotated

import typer

from stone_client.confirmation import DryRunOption, YesOption, confirm
from stone_client.options import ServerOption
from stone_client.streams import JsonOption, echo_json

IdArgument = Annotated[
    str, typer.Argument(metavar="SUBMISSION", help="Six or more digits of its id, or latest, latest~1, …")
]
ReasonOption = Annotated[str, typer.Option(metavar="TEXT", help="Reason, recorded in the audit log.")]


def withdraw(
    submission: IdArgument,
    reason: ReasonOption = "",
    is_confirmed: YesOption = False,
    is_dry_run: DryRunOption = False,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Withdraw a submission from every leaderboard, permanently; it still counts towards the quota."""
    from stone_client.connection import connected
    from stone_client.server.scores import submission_id
    from stone_client.server.submission import withdraw as take_off
    from stone_client.server.submission import withdrawal

    with connected(server) as api:
        chosen_id = submission_id(api, submission)
        act = withdrawal(api, chosen_id)
        confirm(act, {"id": chosen_id}, is_given=is_confirmed, is_dry_run=is_dry_run, as_json=as_json, named=submission)
        taken = take_off(api, chosen_id, reason)
    if as_json:
        echo_json(dict(taken))
    else:
        typer.echo(f"submission {taken['id']} was withdrawn")
