"""`stone inspect`: what is in a recording, and what is wrong with it."""

import typer

from client.inputs import BagArgument
from client.refusals import REFUSED
from client.streams import JsonOption, echo_findings, echo_json
from client.tables import inspection_table, show


def inspect(bag: BagArgument, as_json: JsonOption = False) -> None:
    """Show a recording's topics with their roles, rates and gaps, and what is noticed about them.

    Exit code 1 where something in it cannot be used, named by an error line.
    """
    from services.ingest.inspection import inspect as inspect_bag

    inspection = inspect_bag(bag)
    if as_json:
        echo_json(inspection.as_record())
    else:
        show(inspection_table(inspection.as_record()))
    echo_findings(inspection.findings)
    if any(finding.severity == "error" for finding in inspection.findings):
        raise typer.Exit(REFUSED)
