"""`stone admin tokens`: list and revoke the tokens of a user."""

from typing import Annotated

import typer

from stone_client.commands.admin import RequiredReason
from stone_client.commands.admin.users import UserArgument
from stone_client.confirmation import PermanentAct, YesOption, require_confirmation
from stone_client.options import ServerOption
from stone_client.record_tables import echo_records
from stone_client.streams import JsonOption, echo_json

COLUMNS = {"name": "name", "scopes": "scopes", "expires": "expires_at", "used": "used_at", "id": "id"}


def listed(user: UserArgument, server: ServerOption = None, as_json: JsonOption = False) -> None:
    """List a user's tokens, newest first; their secrets are not stored."""
    from stone_client.connection import administering
    from stone_client.server.admin.users import user_named

    with administering(server) as api:
        tokens = list(api.pages(f"/admin/users/{user_named(api, user)['id']}/tokens"))
    echo_records("tokens", tokens, COLUMNS, as_json=as_json)


def revoke(
    user: UserArgument,
    reason: RequiredReason,
    token: Annotated[str | None, typer.Argument(metavar="[TOKEN]", help="A token's id (default: all).")] = None,
    is_confirmed: YesOption = False,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Revoke one token of a user, or all tokens and sessions except the token of this command."""
    from stone_client.connection import administering
    from stone_client.server.admin.users import user_named

    with administering(server) as api:
        owner = user_named(api, user)
        own, what = f"/admin/users/{owner['id']}", f"token {token}" if token else "all tokens and sessions"
        act = PermanentAct(f"revoke {what} of {owner['name']}", "programs that use them are refused immediately")
        require_confirmation(act, is_given=is_confirmed)
        if token is None:
            record = api.create(f"{own}/credentials/revoke", {"reason": reason})
        else:
            api.send("POST", f"{own}/tokens/{token}/revoke", json={"reason": reason})
            record = {"tokens": 1, "browsers": 0}
    if as_json:
        echo_json({"user": owner["name"], **record})
    else:
        typer.echo(f"revoked: {record['tokens']} tokens, {record['browsers']} sessions")
