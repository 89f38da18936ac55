"""`stone admin rescores`: score all entries of a phase again, compare, and activate the result."""

from typing import Annotated, Any

import typer

from stone_client.commands.admin import RequiredReason
from stone_client.commands.admin.phases import WaitOption
from stone_client.confirmation import DryRunOption, PermanentAct, YesOption, confirm, require_confirmation
from stone_client.options import BenchmarkArgument, PhaseArgument, ServerOption
from stone_client.progress import reported
from stone_client.record_tables import echo_records
from stone_client.streams import JsonOption, echo_json, echo_notice

RescoreArgument = Annotated[str, typer.Argument(metavar="RESCORE", help="A re-score's id, or latest.")]
COLUMNS = {
    "metric": "metric",
    "state": "state",
    "scored": "scored",
    "of": "total",
    "created": "created_at",
    "reason": "reason",
    "id": "id",
}


def listed(
    benchmark: BenchmarkArgument, phase: PhaseArgument, server: ServerOption = None, as_json: JsonOption = False
) -> None:
    """List the re-scores of a phase, newest first."""
    from stone_client.connection import administering
    from stone_client.server.admin.rescores import rescores_path

    with administering(server) as api:
        rescores = list(api.pages(rescores_path(api, benchmark, phase)))
    echo_records("rescores", rescores, COLUMNS, as_json=as_json)


def start(
    benchmark: BenchmarkArgument,
    phase: PhaseArgument,
    reason: RequiredReason,
    metric: Annotated[
        str | None, typer.Option(metavar="METRIC", help="Metric (default: the metric of the board).")
    ] = None,
    truth: Annotated[
        str | None, typer.Option(metavar="ID", help="Ground truth (default: the ground truth of the board).")
    ] = None,
    is_awaited: WaitOption = True,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Score all entries with another metric or ground truth; the board does not change until `activate`."""
    from stone_client.connection import administering
    from stone_client.server.admin.rescores import rescores_path
    from stone_client.server.job_following import follow

    chosen = {"metric": metric, "truth_id": truth}
    body = {"reason": reason, **{key: value for key, value in chosen.items() if value is not None}}
    with administering(server) as api:
        path = rescores_path(api, benchmark, phase)
        record = api.create(path, body)
        if is_awaited and record["job_id"]:
            with reported() as progress:
                follow(api, record["job_id"], progress)
            record = api.read(f"{path}/{record['id']}")
    _echo(record, as_json=as_json)
    echo_notice(f"Next: stone admin rescores diff {benchmark} {phase} {record['id']}")


def diff(
    benchmark: BenchmarkArgument,
    phase: PhaseArgument,
    rescore: RescoreArgument,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show the ranks and values that a re-score would change, as Markdown."""
    from stone_client.connection import administering
    from stone_client.server.admin.rescores import rescore_path

    with administering(server) as api:
        path = f"{rescore_path(api, benchmark, phase, rescore)}/diff"
        if as_json:
            echo_json(api.read(path))
        else:
            typer.echo(api.send("GET", path, params={"format": "md"}).text)


def activate(
    benchmark: BenchmarkArgument,
    phase: PhaseArgument,
    rescore: RescoreArgument,
    reason: RequiredReason,
    is_confirmed: YesOption = False,
    is_dry_run: DryRunOption = False,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Switch the board to a re-score; refused if the board was switched since the difference was computed."""
    from stone_client.connection import administering
    from stone_client.server.admin.rescores import rescore_path

    with administering(server) as api:
        path = rescore_path(api, benchmark, phase, rescore)
        read = api.send("GET", f"{path}/diff")
        act = _switch(f"{benchmark} / {phase}", read.json())
        confirm(act, {"diff": read.json()}, is_given=is_confirmed, is_dry_run=is_dry_run, as_json=as_json)
        match = {"If-Match": read.headers["ETag"]}
        record = api.send("POST", f"{path}/activate", json={"reason": reason}, headers=match).json()
    if as_json:
        echo_json(record)
    else:
        typer.echo(f"in force: {record['metric']} since {record['activated_at'][:19]}")


def abandon(
    benchmark: BenchmarkArgument,
    phase: PhaseArgument,
    rescore: RescoreArgument,
    reason: RequiredReason,
    is_confirmed: YesOption = False,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Abandon a re-score: its run stops, and the board stays as it is."""
    from stone_client.connection import administering
    from stone_client.server.admin.rescores import rescore_path

    with administering(server) as api:
        path = rescore_path(api, benchmark, phase, rescore)
        act = PermanentAct(f"abandon re-score {path.rpartition('/')[2]}", "its scores are never put in force")
        require_confirmation(act, is_given=is_confirmed)
        _echo(api.create(f"{path}/abandon", {"reason": reason}), as_json=as_json)


def _switch(board: str, diff: dict[str, Any]) -> PermanentAct:
    """Return the act of activating the re-score of this difference."""
    leader = ", with a new leader" if diff["is_new_leader"] else ""
    moved = (
        f"ranks move by at most {diff['largest_rank_move']}, values by at most {diff['largest_value_move']:g}{leader}"
    )
    effect = "all users see the new board at once; the old board stays available with --as-of"
    return PermanentAct(f"switch the board {board} to re-score {diff['rescore']['id']} ({moved})", effect)


def _echo(record: dict[str, Any], *, as_json: bool) -> None:
    if as_json:
        echo_json(record)
    else:
        echo_records("rescores", [record], COLUMNS, as_json=False)
