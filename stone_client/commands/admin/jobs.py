"""`stone admin jobs`: list, retry and stop the jobs of all users."""

from itertools import islice
from typing import Annotated

import typer

from stone_base.newer_python import StrEnum
from stone_client.commands.admin import RequiredReason
from stone_client.options import ServerOption
from stone_client.record_tables import echo_records, items_of
from stone_client.streams import JsonOption, echo_json

COLUMNS = {
    "job": "title",
    "state": "state",
    "owner": "owner",
    "sequence": "sequence",
    "created": "created_at",
    "attempts left": "attempts_left",
    "id": "id",
}
ACT_COLUMNS = {"job": "job_id", "state": "state", "refused": "failure"}
REFUSED = 1


class State(StrEnum):
    QUEUED = "queued"
    RUNNING = "running"
    SUCCEEDED = "succeeded"
    FAILED = "failed"
    CANCELLED = "cancelled"


JobsArgument = Annotated[
    list[str], typer.Argument(metavar="JOB...", help="Ids of jobs; the command acts on the whole run of each job.")
]


def listed(
    state: Annotated[State | None, typer.Option(metavar="STATE", help="Only jobs in this state.")] = None,
    queue: Annotated[str | None, typer.Option(metavar="QUEUE", help="Only single jobs of this queue.")] = None,
    owner: Annotated[str | None, typer.Option(metavar="USER", help="Only jobs of this user.")] = None,
    is_dead: Annotated[bool, typer.Option("--dead", help="Only failed jobs with no attempts left.")] = False,
    limit: Annotated[int, typer.Option(metavar="N", min=1, max=100_000, help="Number of jobs, newest first.")] = 50,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """List the jobs of all users, newest first."""
    from stone_client.connection import administering

    choices = {"state": state, "queue": queue, "owner": owner, "dead": "true" if is_dead else None}
    query = {key: str(value) for key, value in choices.items() if value is not None}
    with administering(server) as api:
        jobs = list(islice(api.pages("/admin/jobs", **query), limit))
    echo_records("jobs", jobs, COLUMNS, as_json=as_json)


def show(
    job: Annotated[str, typer.Argument(metavar="JOB", help="A job's id.")],
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show any job with its stages, its failure and its last log lines."""
    from stone_client.connection import administering
    from stone_client.server.admin.jobs import job_id_named
    from stone_client.server.status import any_job_status_of

    with administering(server) as api:
        status = any_job_status_of(api, job_id_named(api, job))
    if as_json:
        echo_json(status.record)
    else:
        status.show()


def retry(
    job_ids: JobsArgument, reason: RequiredReason, server: ServerOption = None, as_json: JsonOption = False
) -> None:
    """Queue failed or cancelled runs again."""
    _act("retry", job_ids, reason, server, as_json=as_json)


def cancel(
    job_ids: JobsArgument, reason: RequiredReason, server: ServerOption = None, as_json: JsonOption = False
) -> None:
    """Stop runs at their next report of progress; `retry` queues them again."""
    _act("cancel", job_ids, reason, server, as_json=as_json)


def terminate(
    job_ids: JobsArgument, reason: RequiredReason, server: ServerOption = None, as_json: JsonOption = False
) -> None:
    """Stop the processes of runs at once; `retry` queues them again."""
    _act("terminate", job_ids, reason, server, as_json=as_json)


def _act(act: str, job_ids: list[str], reason: str, server: str | None, *, as_json: bool) -> None:
    """Act on the run of each job; a refused job does not stop the others, and sets exit code 1."""
    from stone_client.connection import administering
    from stone_client.server.admin.jobs import job_id_named

    with administering(server) as api:
        body = {"act": act, "job_ids": [job_id_named(api, item) for item in job_ids], "reason": reason}
        answer = api.send("POST", "/admin/jobs/acts", json=body).json()
    done = items_of(answer)
    if as_json:
        echo_json({"jobs": done})
    else:
        rows = [{**item, "failure": item["failure"] and item["failure"]["sentence"]} for item in done]
        echo_records("jobs", rows, ACT_COLUMNS, as_json=False)
    if any(item["failure"] for item in done):
        raise typer.Exit(REFUSED)
