"""`stone sequence list` and `stone sequence status`: sequences and jobs, with their progress."""

from typing import Annotated

import typer

from stone_client.options import ServerOption
from stone_client.streams import JsonOption, echo_json

SubjectArgument = Annotated[
    str, typer.Argument(metavar="SEQUENCE|JOB", help="A sequence's name or id, or a job's id; six digits are enough.")
]


def listed(server: ServerOption = None, as_json: JsonOption = False) -> None:
    """List your sequences and the public ones, with their newest runs."""
    _show(None, server, as_json)


def status(subject: SubjectArgument, server: ServerOption = None, as_json: JsonOption = False) -> None:
    """Show a sequence, or a job with its stages, attempts and latest log lines."""
    _show(subject, server, as_json)


def _show(subject: str | None, server: str | None, as_json: bool) -> None:
    from stone_client.connection import connected
    from stone_client.server.status import server_status_of

    with connected(server) as api:
        server_status = server_status_of(api, subject)
    if as_json:
        echo_json(server_status.record)
    else:
        server_status.show()
