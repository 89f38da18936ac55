"""Server connections of the commands, from options, environment and saved credentials."""

from collections.abc import Iterator
from contextlib import contextmanager

from stone_client.api import Api
from stone_client.credentials import choose_server


@contextmanager
def connected(server: str | None) -> Iterator[Api]:
    """Yield the API of `server`, else of the one that is meant where none is named.

    Raises `no_server`, `not_signed_in`, `bad_url`, `bad_credentials_file`.
    """
    with Api(choose_server(server)) as api:
        yield api
