"""`stone sequence cancel`: stop a run."""

from typing import Annotated

import typer

from stone_client.options import ServerOption
from stone_client.streams import JsonOption, echo_json

SubjectArgument = Annotated[str, typer.Argument(metavar="SEQUENCE|JOB", help="A sequence's newest run, or a job's id.")]
ReasonOption = Annotated[str, typer.Option(metavar="TEXT", help="Reason, shown with the job.")]


def cancel(
    subject: SubjectArgument, reason: ReasonOption = "", server: ServerOption = None, as_json: JsonOption = False
) -> None:
    """Stop a run at its next report of progress; finished stages are kept for the next run."""
    from stone_client.connection import connected
    from stone_client.server.sequences import find_job

    with connected(server) as api:
        job = find_job(api, subject)
        record = api.create(f"/jobs/{job['id']}/cancel", {"reason": reason})
    if as_json:
        echo_json(record)
    else:
        title = record.get("title") or record["kind"]
        typer.echo(f"{title} {record['id']}: {record['state']}, stops at its next report of progress")
