"""`stone admin truths`: list and build the ground truths of a phase."""

from typing import Annotated

import typer

from stone_client.commands.admin import RequiredReason
from stone_client.commands.admin.phases import WaitOption
from stone_client.options import BenchmarkArgument, PhaseArgument, ServerOption
from stone_client.progress import reported
from stone_client.record_tables import echo_records
from stone_client.streams import JsonOption, echo_json, echo_notice

COLUMNS = {
    "number": "number",
    "dataset": "dataset",
    "state": "state",
    "in force": "is_active",
    "frames": "frames",
    "created": "created_at",
    "id": "id",
}


def listed(
    benchmark: BenchmarkArgument, phase: PhaseArgument, server: ServerOption = None, as_json: JsonOption = False
) -> None:
    """List the ground truths of a phase, newest first."""
    from stone_client.connection import administering
    from stone_client.server.benchmarks import administered_phase

    with administering(server) as api:
        truths = list(api.pages(f"{administered_phase(api, benchmark, phase)}/ground-truths"))
    echo_records("ground truths", truths, COLUMNS, as_json=as_json)


def build(
    benchmark: BenchmarkArgument,
    phase: PhaseArgument,
    reason: RequiredReason,
    dataset: Annotated[
        str | None, typer.Option(metavar="VERSION", help="The dataset version (default: the phase's).")
    ] = None,
    is_awaited: WaitOption = True,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Build a ground truth; the first of a phase becomes active when it is ready, a later one by a re-score."""
    from stone_client.connection import administering
    from stone_client.server.benchmarks import administered_phase
    from stone_client.server.job_following import follow

    body = {"reason": reason, **({} if dataset is None else {"dataset": dataset})}
    with administering(server) as api:
        own = f"{administered_phase(api, benchmark, phase)}/ground-truths"
        accepted = api.create(own, body)
        if is_awaited:
            with reported() as progress:
                follow(api, accepted["job"]["id"], progress)
        (record,) = (truth for truth in api.pages(own) if truth["id"] == accepted["ground_truth"]["id"])
    if as_json:
        echo_json({"ground_truth": record, "job_id": accepted["job"]["id"]})
        return
    echo_records("ground truths", [record], COLUMNS, as_json=False)
    if is_awaited and not record["is_active"]:
        echo_notice(f"Next: stone admin rescores start {benchmark} {phase} --truth {record['id']} --reason TEXT")
