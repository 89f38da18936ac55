"""`stone watch`: stay with a job until it has ended."""

from typing import Annotated

import typer

from client.inputs import ServerOption
from client.streams import JsonOption, echo_json

SubjectArgument = Annotated[
    str, typer.Argument(metavar="JOB|SEQUENCE", help="A job's id, or a sequence, whose newest run it is then.")
]


def watch(subject: SubjectArgument, server: ServerOption = None, as_json: JsonOption = False) -> None:
    """Follow a job to its end. Exit code 1, with code and reason, when it fails."""
    from client.connecting import connected
    from client.remote import find_job
    from client.watching import watch_run

    with connected(server) as api:
        job = watch_run(api, find_job(api, subject))
    if as_json:
        echo_json(job)
    else:
        typer.echo(f"{job['kind']} {job['id']} {job['state']}")
