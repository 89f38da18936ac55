"""`stone benchmark results`: the scores of a submission, or its progress."""

from typing import TYPE_CHECKING, Annotated, Any

import typer

from stone_base.newer_python import StrEnum
from stone_client.options import ServerOption
from stone_client.streams import JsonOption, echo_json
from stone_client.tables import show

if TYPE_CHECKING:
    from rich.table import Table

    from stone_client.api import Api


class ResultGrouping(StrEnum):
    """The property by which the frames of a result are grouped."""

    SEQUENCE = "sequence"
    ENVIRONMENT = "environment"
    ILLUMINATION = "illumination"
    DISTANCE = "distance"


IdArgument = Annotated[
    str | None,
    typer.Argument(
        metavar="[SUBMISSION]",
        help="Six or more digits of its id, or latest, latest~1, … (default: all of your teams).",
    ),
]
ByOption = Annotated[
    ResultGrouping | None,
    typer.Option("--by", help="Break scores down by this property; in a hidden phase only after its end."),
]


def results(
    submission: IdArgument = None, by: ByOption = None, server: ServerOption = None, as_json: JsonOption = False
) -> None:
    """Show the scores of a submission, in total or broken down, or list the submissions of your teams."""
    from stone_client.connection import connected
    from stone_client.server.scores import submission_id

    if submission is None and by is not None:
        raise typer.BadParameter("which submission?", param_hint="SUBMISSION")
    with connected(server) as api:
        named = None if submission is None else submission_id(api, submission)
        record, tables = _listed(api) if named is None else _found(api, named, by)
    if as_json:
        echo_json(record)
        return
    for table in tables:
        show(table)


def _listed(api: "Api") -> tuple[dict[str, Any], list["Table"]]:
    from stone_client.server.scores import read_submissions, submissions_table

    submissions = read_submissions(api)
    return {"submissions": submissions}, [submissions_table(submissions)]


def _found(api: "Api", submission_id: str, by: ResultGrouping | None) -> tuple[dict[str, Any], list["Table"]]:
    from stone_client.server.scores import breakdown_table, read_breakdown, read_results, results_tables

    if by is None:
        record = read_results(api, submission_id)
        return record, results_tables(record)
    record = read_breakdown(api, submission_id, by.value)
    return record, [breakdown_table(record)]
