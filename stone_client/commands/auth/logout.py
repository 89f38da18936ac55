"""`stone auth logout`: revoke and delete the token of a server."""

from typing import Annotated

import typer

from stone_client.options import ServerOption
from stone_client.streams import JsonOption, echo_json


def logout(
    server: ServerOption = None,
    is_local: Annotated[
        bool, typer.Option("--local", help="Delete the stored token without a request to the server; it stays valid.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Revoke the stored token of a server, and delete it from ~/.config/stone/credentials.json."""
    from stone_client.api import Api
    from stone_client.credentials import forget, stored_server
    from stone_client.errors import ServerRefusedError

    stored = stored_server(server)
    is_revoked = False
    if not is_local:
        with Api(stored) as api:
            try:
                api.send("DELETE", "/tokens/current")
                is_revoked = True
            except ServerRefusedError as error:
                if error.status != 401:  # the token has already ended
                    raise
    forget(stored.url)
    if as_json:
        echo_json({"url": stored.url, "is_revoked": is_revoked})
    else:
        typer.echo(f"signed out of {stored.url}")
