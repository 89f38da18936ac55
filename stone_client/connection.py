"""Server connections of the commands, from options, environment and saved credentials."""

from collections.abc import Iterator
from contextlib import contextmanager

from stone_client.api import Api
from stone_client.credentials import choose_server
from stone_client.errors import ServerRefusedError
from stone_client.streams import echo_notice

FORBIDDEN = 403


@contextmanager
def connected(server: str | None) -> Iterator[Api]:
    """Yield the API of `server`, or of the default server if it is None.

    Raises `no_server`, `not_signed_in`, `bad_url`, `bad_credentials_file`.
    """
    with Api(choose_server(server)) as api:
        yield api


@contextmanager
def administering(server: str | None) -> Iterator[Api]:
    """Yield the API as `connected` does; after a refused scope or role, print how to sign in as an administrator.

    Raises what `connected` raises.
    """
    with connected(server) as api:
        try:
            yield api
        except ServerRefusedError as error:
            if error.status == FORBIDDEN:
                echo_notice(f"Administrators sign in by: stone auth login {api.url} --name NAME --admin")
            raise
