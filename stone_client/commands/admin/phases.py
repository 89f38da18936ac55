"""`stone admin phases`: a phase with the administrator's details, its inputs and its alarms."""

from pathlib import Path
from typing import Annotated

import typer

from stone_base.counts import counted
from stone_base.errors import one_line
from stone_client.commands.admin import RequiredReason
from stone_client.confirmation import DryRunOption, PermanentAct, YesOption, confirm, require_confirmation
from stone_client.options import BenchmarkArgument, PhaseArgument, ServerOption
from stone_client.record_tables import echo_records, items_of
from stone_client.streams import JsonOption, echo_json
from stone_client.tables import DASH

WaitOption = Annotated[bool, typer.Option("--wait/--no-wait", help="Wait until the job has ended.")]
SHOWN = (
    *("dataset", "part", "mask", "is_hidden", "every_nth", "standing", "opens_at", "closes_at", "named_from_at"),
    *("scorings_per_window", "window_s", "scorings_total", "validations_per_day", "team_members", "id"),
)


def show(
    benchmark: BenchmarkArgument, phase: PhaseArgument, server: ServerOption = None, as_json: JsonOption = False
) -> None:
    """Show the rules of a phase, and its findings, such as labels that became public."""
    from stone_client.connection import administering
    from stone_client.server.benchmarks import administered_phase

    with administering(server) as api:
        record = api.read(administered_phase(api, benchmark, phase))
    if as_json:
        echo_json(record)
        return
    for field in SHOWN:
        typer.echo(one_line(f"{field}: {DASH if record[field] is None else record[field]}"))
    for finding in record["findings"]:
        typer.echo(one_line(f"{finding['severity']}: {finding['code']}: {finding['message']}"), err=True)


def inputs(
    benchmark: BenchmarkArgument,
    phase: PhaseArgument,
    reason: RequiredReason,
    is_awaited: WaitOption = True,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Create the missing inputs of a phase: the data that participants predict from."""
    from stone_client.connection import administering
    from stone_client.server.admin.inputs import create_inputs
    from stone_client.server.benchmarks import read_phase

    with administering(server) as api:
        own = f"/phases/{read_phase(api, benchmark, phase)['id']}"
        made = create_inputs(api, own, reason, is_awaited=is_awaited)
    if as_json:
        echo_json(made)
        return
    columns = {"sequence": "name", "files": "files", "bytes": "tar_bytes", "created": "created_at"}
    echo_records("inputs", made["inputs"], columns, as_json=False)


def alarms(
    benchmark: BenchmarkArgument,
    phase: PhaseArgument,
    has_dismissed: Annotated[bool, typer.Option("--all", help="Include dismissed alarms.")] = False,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """List the open alarms of a phase: near-duplicate or implausibly good entries."""
    from stone_client.connection import administering
    from stone_client.server.benchmarks import administered_phase

    with administering(server) as api:
        path = f"{administered_phase(api, benchmark, phase)}/alarms"
        records = list(api.pages(path, **({"dismissed": "true"} if has_dismissed else {})))
    columns = {"kind": "kind", "subject": "subject", "raised": "created_at", "dismissed": "dismissed_at", "id": "id"}
    echo_records("alarms", records, columns, as_json=as_json)


def dismiss(
    alarm: Annotated[str, typer.Argument(metavar="ALARM", help="An alarm's id.")],
    reason: RequiredReason,
    is_confirmed: YesOption = False,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Dismiss an alarm with the outcome of its review."""
    from stone_client.connection import administering

    require_confirmation(PermanentAct(f"dismiss alarm {alarm}", "it is never raised again"), is_given=is_confirmed)
    with administering(server) as api:
        record = api.create(f"/admin/alarms/{alarm}/dismiss", {"reason": reason})
    if as_json:
        echo_json(record)
    else:
        typer.echo(f"dismissed: {record['kind']} {record['id']}")


def reported_rows(
    benchmark: BenchmarkArgument, phase: PhaseArgument, server: ServerOption = None, as_json: JsonOption = False
) -> None:
    """List the reported rows of a phase: published results of others, never ranked."""
    from stone_client.connection import administering
    from stone_client.server.benchmarks import administered_phase

    with administering(server) as api:
        rows = items_of(api.send("GET", f"{administered_phase(api, benchmark, phase)}/reported").json())
    columns = {"method": "method", "track": "modality", "kind": "kind", "mIoU": "miou", "source": "source"}
    echo_records("reported", rows, columns, as_json=as_json)


def report(
    benchmark: BenchmarkArgument,
    phase: PhaseArgument,
    file: Annotated[
        Path,
        typer.Argument(metavar="FILE", exists=True, dir_okay=False, help="YAML or JSON file with a list of all rows."),
    ],
    reason: RequiredReason,
    is_confirmed: YesOption = False,
    is_dry_run: DryRunOption = False,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Replace all reported rows of a phase with the rows of a file."""
    from stone_client.connection import administering
    from stone_client.files.yaml_file import read_yaml
    from stone_client.server.benchmarks import administered_phase

    rows = read_yaml(file)
    if not isinstance(rows, list):
        raise typer.BadParameter("it contains no list of rows", param_hint="FILE")
    with administering(server) as api:
        path = f"{administered_phase(api, benchmark, phase)}/reported"
        answer = api.send("GET", path)
        clause = f"replace the {len(items_of(answer.json()))} reported rows of {benchmark} / {phase} by {len(rows)}"
        act = PermanentAct(clause, "the current rows are lost")
        confirm(act, {"rows": rows}, is_given=is_confirmed, is_dry_run=is_dry_run, as_json=as_json)
        body, match = {"rows": rows, "reason": reason}, {"If-Match": answer.headers["ETag"]}
        done = items_of(api.send("PUT", path, json=body, headers=match).json())
    if as_json:
        echo_json({"reported": done})
    else:
        typer.echo(f"{benchmark} / {phase}: {counted(len(done), 'reported row')}")
