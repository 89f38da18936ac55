"""`stone benchmark leaderboard`: the board of a phase."""

from pathlib import Path
from typing import Annotated

import typer

from stone_base.newer_python import StrEnum
from stone_client.choices import in_folder, refuse_options
from stone_client.options import BenchmarkArgument, Modality, PhaseArgument, ServerOption
from stone_client.streams import JsonOption, echo_json, echo_notice
from stone_client.tables import show
from stone_files.atomic import atomic_file


class Form(StrEnum):
    """Formats for programs and for papers."""

    JSON = "json"
    CSV = "csv"
    MD = "md"
    TEX = "tex"
    PARQUET = "parquet"


TrackOption = Annotated[Modality | None, typer.Option(help="Only entries of this declared modality.")]
AsOfOption = Annotated[
    str, typer.Option(metavar="TIME", help="The leaderboard as of this time, such as 2026-06-01T00:00:00Z.")
]
AllOption = Annotated[bool, typer.Option("--all", help="All entries, not only the best of each team.")]
FormOption = Annotated[Form | None, typer.Option("--format", help="Export in this format instead of printing a table.")]
OutputOption = Annotated[
    Path | None,
    typer.Option(
        "-o", "--output", metavar="FILE", dir_okay=False, callback=in_folder, help="Output file (default: stdout)."
    ),
]


def leaderboard(
    benchmark: BenchmarkArgument,
    phase: PhaseArgument,
    track: TrackOption = None,
    as_of: AsOfOption = "",
    everything: AllOption = False,
    form: FormOption = None,
    output: OutputOption = None,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show the leaderboard of a phase, or export it as CSV, Parquet, Markdown or LaTeX."""
    from stone_client.connection import connected
    from stone_client.server.boards import BoardSelection, board_file, board_table, read_board, reported_notes

    if form is None:
        refuse_options("it requires --format", {"--output": output})
    else:
        refuse_options(
            f"it cannot be combined with --format {form.value}; choose one of the two options", {"--json": as_json}
        )
    if form is Form.PARQUET and output is None:
        raise typer.BadParameter("parquet is binary; name a file with --output", param_hint="--output")
    tracked = "all" if track is None else track.value
    selection = BoardSelection(benchmark, phase, tracked, as_of, "all" if everything else "best")
    with connected(server) as api:
        if form is not None:
            _write(board_file(api, selection, form.value), output)
            return
        record = read_board(api, selection)
    if as_json:
        echo_json(record)
        return
    show(board_table(record))
    for line in reported_notes(record["rows"]):
        typer.echo(line)
    for note in record["notes"]:
        echo_notice(note)


def _write(content: bytes, output: Path | None) -> None:
    if output is None:
        typer.echo(content.decode("utf-8").rstrip("\n"))
    else:
        with atomic_file(output) as staging:
            staging.write_bytes(content)
        typer.echo(f"{output} ({len(content):,} bytes)")
