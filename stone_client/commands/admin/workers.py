"""`stone admin workers`: the worker processes and their jobs."""

from stone_client.options import ServerOption
from stone_client.record_tables import echo_records
from stone_client.streams import JsonOption, echo_json

COLUMNS = {"worker": "name", "queues": "queues", "silent": "is_silent", "heartbeat s ago": "age_s", "job": "kind"}


def workers(server: ServerOption = None, as_json: JsonOption = False) -> None:
    """List the worker processes: heartbeat, queues and current job."""
    from stone_client.connection import administering
    from stone_client.streams import echo_notice

    with administering(server) as api:
        record = api.read("/admin/workers")
    if as_json:
        echo_json(record)
        return
    echo_records("workers", record["workers"], {**COLUMNS, "job id": "job_id"}, as_json=False)
    if not record["is_broker_reachable"]:
        echo_notice("the broker does not answer: jobs start when the sweeper finds them")
