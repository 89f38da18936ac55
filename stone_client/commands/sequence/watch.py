"""`stone sequence watch`: follow a job to its end."""

from typing import Annotated

import typer

from stone_client.options import ServerOption
from stone_client.streams import JsonOption, echo_json

SubjectArgument = Annotated[
    str,
    typer.Argument(
        metavar="JOB|SEQUENCE", help="A job's id, or a sequence (its newest run); six digits of an id are enough."
    ),
]


def watch(subject: SubjectArgument, server: ServerOption = None, as_json: JsonOption = False) -> None:
    """Follow a job to its end. If the job fails, print code and reason with exit code 1."""
    from stone_client.connection import connected
    from stone_client.server.run_watch import watch_run
    from stone_client.server.sequences import find_job

    with connected(server) as api:
        job = watch_run(api, find_job(api, subject))
    if as_json:
        echo_json(job)
    else:
        typer.echo(f"{job['kind']} {job['id']} {job['state']}")
