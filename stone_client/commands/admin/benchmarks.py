"""`stone admin benchmarks`: create and change benchmarks from a file."""

from pathlib import Path
from typing import Annotated

import typer

from stone_base.errors import one_line
from stone_client.commands.admin import RequiredReason
from stone_client.confirmation import DryRunOption
from stone_client.options import ServerOption
from stone_client.record_tables import echo_records
from stone_client.streams import JsonOption, echo_json, echo_notice

FileArgument = Annotated[
    Path,
    typer.Argument(metavar="FILE", exists=True, dir_okay=False, help="benchmark.yaml: the benchmark and its phases."),
]
COLUMNS = {"name": "name", "title": "title", "phases": "phases", "public": "is_public", "created": "created_at"}


def listed(server: ServerOption = None, as_json: JsonOption = False) -> None:
    """List the benchmarks, newest first."""
    from stone_client.connection import administering

    with administering(server) as api:
        echo_records("benchmarks", list(api.pages("/benchmarks")), COLUMNS, as_json=as_json)


def apply_file(
    file: FileArgument,
    reason: RequiredReason,
    is_dry_run: DryRunOption = False,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Create the benchmark of a file, or change the benchmark and its phases to match the file.

    Fields and phases that the file leaves out stay as they are.
    """
    from stone_client.connection import administering
    from stone_client.server.admin.benchmark_file import apply, changes_of, phases_beside, read_benchmark_file

    wanted = read_benchmark_file(file)
    with administering(server) as api:
        changes = changes_of(api, wanted)
        beside = phases_beside(api, wanted) if wanted.phases else []
        findings = [] if is_dry_run else apply(api, changes, reason)
    records = [item.as_record() for item in changes]
    if as_json:
        record = {"benchmark": wanted.name, "dry_run": is_dry_run, "changes": records}
        echo_json({**record, "phases_beside": beside, "findings": findings})
    else:
        for change in records:
            typer.echo(one_line(f"{change['act']} {change['subject']}"))
            for field in change["fields"]:
                before = "" if change["act"] == "create" else f"{field['from']!r} → "
                typer.echo(one_line(f"  {field['field']}: {before}{field['to']!r}"))
        outcome = "nothing was changed" if is_dry_run else "applied"
        typer.echo(f"{wanted.name}: {outcome if changes else 'equals the file, nothing to change'}")
    for finding in findings:
        typer.echo(one_line(f"warning: {finding}"), err=True)
    if beside:
        echo_notice(f"not in the file, unchanged: {', '.join(beside)}")
