"""From what the user typed and what is remembered to an open connection; for the commands that ask a server."""

from collections.abc import Iterator
from contextlib import contextmanager

from client.api import Api
from client.credentials import choose_server


@contextmanager
def connected(server: str | None) -> Iterator[Api]:
    """Yield the API of `server`, else of the one that is meant where none is named.

    Raises `NoServerError`, `NotSignedInError`, `BadUrlError`, `BadCredentialsFileError`.
    """
    with Api(choose_server(server)) as api:
        yield api
