"""`stone withdraw`: a submission off every board."""

from typing import Annotated

import typer

from stone_client.options import ServerOption
from stone_client.streams import JsonOption, echo_json

IdArgument = Annotated[str, typer.Argument(metavar="SUBMISSION", help="Its id, or latest, latest~1, …")]
ReasonOption = Annotated[str, typer.Option(metavar="TEXT", help="Reason, recorded in the audit log.")]


def withdraw(
    submission: IdArgument, reason: ReasonOption = "", server: ServerOption = None, as_json: JsonOption = False
) -> None:
    """Withdraw a submission from every leaderboard, permanently; it still counts towards the quota."""
    from stone_client.connection import connected
    from stone_client.server.scores import submission_id
    from stone_client.server.submission import withdraw as take_off

    with connected(server) as api:
        taken = take_off(api, submission_id(api, submission), reason)
    if as_json:
        echo_json(dict(taken))
    else:
        typer.echo(f"submission {taken['id']} was withdrawn")
