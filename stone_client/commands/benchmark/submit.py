"""`stone benchmark submit`: submit a zip of predictions to a benchmark and print its scores."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer

from stone_client.options import BenchmarkOption, Modality, PhaseOption, ServerOption, SubmissionArgument
from stone_client.progress import reported, transferred
from stone_client.refusals import refuse_report
from stone_client.streams import JsonOption, echo_json, echo_notice
from stone_client.tables import show

LONGEST_PAGE = 20_000

TeamOption = Annotated[str, typer.Option(metavar="TEAM", help="A team of yours, by name or id.")]
MethodOption = Annotated[str, typer.Option(metavar="NAME", help="Name of the method on the leaderboard.")]
ModalityOption = Annotated[Modality, typer.Option(help="Modality: C (cameras), L (LiDAR), R (radar), combined with +.")]
DescriptionOption = Annotated[
    Path | None,
    typer.Option(
        "--description",
        metavar="FILE",
        exists=True,
        dir_okay=False,
        help="File with the description of the method, plain text.",
    ),
]
ValidateOption = Annotated[
    bool,
    typer.Option("--validate-only", help="Only check the file on the server; does not count towards the quota."),
]
BaselineOption = Annotated[
    bool, typer.Option("--baseline", help="Submit as a baseline, shown but not ranked; for organisers.")
]
WaitOption = Annotated[bool, typer.Option("--wait/--no-wait", help="Wait until the submission has finished.")]
AgainOption = Annotated[
    bool, typer.Option("--again", help="Submit even if this file was already submitted under this name.")
]


def submit(
    submission: SubmissionArgument,
    benchmark: BenchmarkOption,
    phase: PhaseOption,
    team: TeamOption,
    method: MethodOption,
    modality: ModalityOption,
    description: DescriptionOption = None,
    validate_only: ValidateOption = False,
    baseline: BaselineOption = False,
    wait: WaitOption = True,
    again: AgainOption = False,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Submit predictions, wait and print the scores. If the command is run again, it resumes."""
    from stone_client.connection import connected
    from stone_client.server.benchmarks import read_phase
    from stone_client.server.scores import read_results
    from stone_client.server.submission import SubmissionDescription, SubmissionInvalidError, settled
    from stone_client.server.submission import submit as send
    from stone_client.server.teams import find_team

    if validate_only and baseline:
        raise typer.BadParameter("a baseline cannot be validation-only", param_hint="--baseline")
    kind = "validation" if validate_only else "baseline" if baseline else "entry"
    with connected(server) as api:
        at = read_phase(api, benchmark, phase)["id"], find_team(api, team)["id"]
        entry = SubmissionDescription(*at, method, modality.value, _page(description), kind)
        with transferred() as progress:
            sent = send(api, submission, entry, progress, again=again)
        if not wait:
            _say_sent(dict(sent), as_json=as_json)
            return
        echo_notice(f"submission {sent['id']} {sent['state']}")
        try:
            with reported() as progress:
                ended = settled(api, sent, progress)
        except SubmissionInvalidError as error:
            refuse_report(error.report, as_json=as_json)
        _say_ended(dict(ended), lambda: read_results(api, ended["id"]), as_json=as_json)


def _page(description: Path | None) -> str:
    if description is None:
        return ""
    try:
        text = description.read_text("utf-8")
    except UnicodeDecodeError:
        _no_page("it is not UTF-8 text")
    return text if len(text) <= LONGEST_PAGE else _no_page(f"it has more than {LONGEST_PAGE:,} characters")


def _no_page(why: str) -> NoReturn:
    raise typer.BadParameter(why, param_hint="--description")


def _say_sent(sent: dict[str, Any], *, as_json: bool) -> None:
    if as_json:
        echo_json(sent)
    else:
        typer.echo(f"submission {sent['id']} {sent['state']}")
        echo_notice(f"Next: stone benchmark results {sent['id']}")


def _say_ended(ended: dict[str, Any], results: Callable[[], dict[str, Any]], *, as_json: bool) -> None:
    from stone_client.server.scores import results_tables

    scored = results() if ended["state"] == "scored" else None
    if as_json:
        echo_json({**ended, "results": scored})
        return
    if scored is None:
        typer.echo("valid")
        return
    for table in results_tables(scored):
        show(table)
    echo_notice(f"Next: stone benchmark leaderboard {scored['benchmark']} {scored['phase']}")
