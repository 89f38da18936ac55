"""`stone inspect`: what is in a recording, and what is wrong with it."""

from client.inputs import BagArgument
from client.streams import JsonOption, echo_findings, echo_json
from client.tables import inspection_table, show


def inspect(bag: BagArgument, as_json: JsonOption = False) -> None:
    """Show a recording's topics with their roles, rates and gaps, and what is noticed about them."""
    from services.ingest.inspection import inspect as inspect_bag

    inspection = inspect_bag(bag)
    if as_json:
        echo_json(inspection.as_record())
        return
    show(inspection_table(inspection.as_record()))
    echo_findings(inspection.findings)
