"""`stone auth status`: the user, scopes and lifetime of the token for a server."""

from typing import Annotated

import typer

from stone_client.options import ServerOption
from stone_client.record_tables import echo_records
from stone_client.streams import JsonOption, echo_json
from stone_client.tables import safe_text


def status(
    server: ServerOption = None,
    is_of_all: Annotated[
        bool, typer.Option("--all", help="List the servers with a stored token, without a request.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Show the server, user, role and scopes that the commands use, and when the token expires."""
    from stone_client.connection import connected
    from stone_client.credentials import read_credentials

    if is_of_all:
        if server is not None:
            raise typer.BadParameter("all servers are listed", param_hint="--server")
        known = read_credentials()
        stored = [{"url": url, "is_default": url == known.default} for url in sorted(known.token_of)]
        echo_records("servers", stored, {"server": "url", "default": "is_default"}, as_json=as_json)
        return
    with connected(server) as api:
        me = api.read("/me")
        url = api.url
    record = {"url": url, **{key: me[key] for key in ("name", "role", "scopes", "expires_at")}}
    if as_json:
        echo_json(record)
        return
    typer.echo(safe_text(f"{record['name']} ({record['role']}) at {url}; scopes: {', '.join(record['scopes'])}"))
    typer.echo(f"the token expires at {str(record['expires_at'])[:19]} UTC")
