"""`stone dataset splits show`: the sequences of the draft's train, val and test."""

from stone_client.options import ServerOption
from stone_client.streams import JsonOption, echo_json


def show(server: ServerOption = None, as_json: JsonOption = False) -> None:
    """Show the draft splits and their findings."""
    from stone_client.connection import connected
    from stone_client.server.splits import current, show_splits

    with connected(server) as api:
        record = current(api)
    if as_json:
        echo_json(record)
    show_splits(record, as_json=as_json)
