"""`stone status`: sequences and jobs, with their progress."""

from typing import Annotated

import typer

from stone_client.options import ServerOption
from stone_client.streams import JsonOption, echo_json

SubjectArgument = Annotated[
    str | None, typer.Argument(metavar="[SEQUENCE|JOB]", help="A sequence's name or id, or a job's id; else all.")
]


def status(subject: SubjectArgument = None, server: ServerOption = None, as_json: JsonOption = False) -> None:
    """Show your sequences, one of them, or a job with its stages, attempts and latest log lines."""
    from stone_client.connection import connected
    from stone_client.server.status import server_status_of

    with connected(server) as api:
        server_status = server_status_of(api, subject)
    if as_json:
        echo_json(server_status.record)
    else:
        server_status.show()
