"""`stone admin submissions`: hide entries from boards, and show them again."""

from typing import Annotated

import typer

from stone_client.commands.admin import RequiredReason
from stone_client.options import ServerOption
from stone_client.streams import JsonOption, echo_json

SubmissionArgument = Annotated[str, typer.Argument(metavar="SUBMISSION", help="A submission's id.")]


def hide(
    submission: SubmissionArgument, reason: RequiredReason, server: ServerOption = None, as_json: JsonOption = False
) -> None:
    """Hide a submission from all boards; its team can read the reason."""
    _put(submission, reason, server, is_hidden=True, as_json=as_json)


def show(
    submission: SubmissionArgument, reason: RequiredReason, server: ServerOption = None, as_json: JsonOption = False
) -> None:
    """Show a hidden submission on boards again."""
    _put(submission, reason, server, is_hidden=False, as_json=as_json)


def _put(submission: str, reason: str, server: str | None, *, is_hidden: bool, as_json: bool) -> None:
    from urllib.parse import quote

    from stone_client.connection import administering

    with administering(server) as api:
        path = f"/admin/submissions/{quote(submission, safe='')}/visibility"
        record = api.send("PUT", path, json={"hidden": is_hidden, "reason": reason}).json()
    if as_json:
        echo_json(record)
    else:
        typer.echo(f"submission {record['id']} is {'hidden' if is_hidden else 'shown'}")
