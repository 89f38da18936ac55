"""`stone status`: what is there and how far it is."""

from typing import Annotated

import typer

from client.inputs import ServerOption
from client.streams import JsonOption, echo_json

SubjectArgument = Annotated[
    str | None, typer.Argument(metavar="[SEQUENCE|JOB]", help="A sequence's name or id, or a job's id; else all.")
]


def status(subject: SubjectArgument = None, server: ServerOption = None, as_json: JsonOption = False) -> None:
    """Show your sequences, or one of them, or a job with its stages, attempts and last lines."""
    from client.connecting import connected
    from client.standing import standing_of

    with connected(server) as api:
        standing = standing_of(api, subject)
    if as_json:
        echo_json(standing.record)
    else:
        standing.show()
