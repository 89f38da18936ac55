"""`stone results`: what a submission scored, or how far it is."""

from enum import StrEnum
from typing import Annotated, Any

import typer

from client.inputs import ServerOption
from client.streams import JsonOption, echo_json
from client.tables import show


class By(StrEnum):
    """What the frames of a result are grouped by."""

    SEQUENCE = "sequence"
    ENVIRONMENT = "environment"
    ILLUMINATION = "illumination"
    DISTANCE = "distance"


IdArgument = Annotated[
    str | None, typer.Argument(metavar="[SUBMISSION]", help="A submission's id; else all of your teams.")
]
ByOption = Annotated[By | None, typer.Option("--by", help="In parts; of a hidden phase once it has ended.")]


def results(
    submission: IdArgument = None, by: ByOption = None, server: ServerOption = None, as_json: JsonOption = False
) -> None:
    """Show what a submission scored, whole or in parts, or list the submissions of your teams."""
    from client.connecting import connected
    from client.scores import (
        breakdown_table,
        read_breakdown,
        read_results,
        read_submissions,
        results_tables,
        submissions_table,
    )

    if submission is None and by is not None:
        raise typer.BadParameter("which submission?", param_hint="SUBMISSION")
    with connected(server) as api:
        if submission is None:
            record: dict[str, Any] = {"submissions": read_submissions(api)}
            tables = [submissions_table(record["submissions"])]
        elif by is None:
            record = read_results(api, submission)
            tables = results_tables(record)
        else:
            record = read_breakdown(api, submission, by.value)
            tables = [breakdown_table(record)]
    if as_json:
        echo_json(record)
        return
    for table in tables:
        show(table)
