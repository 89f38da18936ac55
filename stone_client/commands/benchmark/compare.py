"""`stone benchmark compare`: two submissions to one phase, side by side."""

from typing import Annotated

import typer

from stone_client.options import ServerOption
from stone_client.streams import JsonOption, echo_json, echo_notice
from stone_client.tables import show

FirstArgument = Annotated[
    str, typer.Argument(metavar="A", help="A submission: six or more digits of its id, or latest, latest~1, …")
]
SecondArgument = Annotated[
    str, typer.Argument(metavar="B", help="Another submission to the same phase, in the same notation.")
]


def compare(a: FirstArgument, b: SecondArgument, server: ServerOption = None, as_json: JsonOption = False) -> None:
    """Compare two submissions frame by frame: differences, intervals and significance."""
    from stone_client.connection import connected
    from stone_client.server.scores import compare as compare_both
    from stone_client.server.scores import comparison_table, submission_id

    with connected(server) as api:
        a_id, b_id = submission_id(api, a), submission_id(api, b)
        if a_id == b_id:
            raise typer.BadParameter(
                f"A and B are the same submission, {a_id}; name another submission", param_hint="B"
            )
        record = compare_both(api, a_id, b_id)
    if as_json:
        echo_json(record)
        return
    show(comparison_table(record))
    if record["is_withheld"]:
        echo_notice("intervals and tests of a hidden phase are shown once it has ended")
