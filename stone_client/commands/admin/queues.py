"""`stone admin queues`: list, pause, drain and resume the queues of jobs."""

from typing import Annotated

import typer

from stone_base.newer_python import StrEnum
from stone_client.commands.admin import RequiredReason
from stone_client.options import ServerOption
from stone_client.record_tables import echo_records, items_of
from stone_client.streams import JsonOption

COLUMNS = {
    "queue": "name",
    "mode": "mode",
    "ready": "ready",
    "waiting": "waiting",
    "running": "running",
    "succeeded in 15 min": "succeeded_lately",
    "failed in 15 min": "failed_lately",
}


class Queue(StrEnum):
    INGEST = "ingest"
    LABELER = "labeler"
    EVAL = "eval"
    NOTIFY = "notify"


QueueArgument = Annotated[Queue, typer.Argument(metavar="QUEUE", help="ingest, labeler, eval or notify.")]


def listed(server: ServerOption = None, as_json: JsonOption = False) -> None:
    """List the queues with their mode and the numbers of their jobs."""
    from stone_client.connection import administering

    with administering(server) as api:
        answer = api.send("GET", "/admin/queues").json()
    echo_records("queues", items_of(answer), COLUMNS, as_json=as_json)


def pause(
    queue: QueueArgument, reason: RequiredReason, server: ServerOption = None, as_json: JsonOption = False
) -> None:
    """Stop starting jobs of a queue."""
    _switch(queue, "pause", reason, server, as_json=as_json)


def drain(
    queue: QueueArgument, reason: RequiredReason, server: ServerOption = None, as_json: JsonOption = False
) -> None:
    """Run the queued jobs of a queue, and accept no new jobs."""
    _switch(queue, "drain", reason, server, as_json=as_json)


def resume(
    queue: QueueArgument, reason: RequiredReason, server: ServerOption = None, as_json: JsonOption = False
) -> None:
    """Resume a queue that was paused or drained."""
    _switch(queue, "resume", reason, server, as_json=as_json)


def _switch(queue: Queue, act: str, reason: str, server: str | None, *, as_json: bool) -> None:
    from stone_client.connection import administering

    with administering(server) as api:
        switched = api.create(f"/admin/queues/{queue}/{act}", {"reason": reason})
    echo_records("queues", [switched], COLUMNS, as_json=as_json)
