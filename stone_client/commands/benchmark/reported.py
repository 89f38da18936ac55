"""`stone benchmark reported`: add published rows, or a ceiling, to a board, marked as not scored here."""

from typing import Annotated

import typer

from stone_client.options import BenchmarkOption, PhaseOption, ServerOption
from stone_client.streams import JsonOption, echo_json, echo_notice
from stone_client.tables import show

TableArgument = Annotated[
    str, typer.Argument(metavar="TABLE", help="table2 (Table II of the STONE paper), or ceiling.json of stone ceiling.")
]
ReasonOption = Annotated[str, typer.Option(metavar="TEXT", help="Reason, recorded in the audit log.")]
ReplaceOption = Annotated[bool, typer.Option("--replace", help="Replace existing rows of these methods that differ.")]


def reported(
    table: TableArgument,
    benchmark: BenchmarkOption,
    phase: PhaseOption,
    reason: ReasonOption = "as published",
    replace: ReplaceOption = False,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Add the rows of a published table or a ceiling to a leaderboard, unranked; for administrators.

    Existing rows are kept.
    """
    from stone_client.connection import connected
    from stone_client.server.boards import reported_notes
    from stone_client.server.published_tables import table_named
    from stone_client.server.reported import Putting, put_table, shown_table

    with connected(server) as api:
        record = put_table(api, table_named(table), Putting(benchmark, phase, reason, replace))
    if as_json:
        echo_json(record)
        return
    show(shown_table(record))
    for line in (record["source"], *reported_notes(record["rows"])):
        typer.echo(line)
    echo_notice(f"Next: stone benchmark leaderboard {benchmark} {phase}")
