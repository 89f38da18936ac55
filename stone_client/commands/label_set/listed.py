"""`stone label-set list`: the label sets of a sequence on a server."""

from stone_client.options import SequenceArgument, ServerOption
from stone_client.streams import JsonOption, echo_json
from stone_client.tables import show


def listed(sequence: SequenceArgument, server: ServerOption = None, as_json: JsonOption = False) -> None:
    """List all label sets of a sequence on the server, newest first, and mark the active one."""
    from stone_client.connection import connected
    from stone_client.server.label_sets import label_set_table, label_sets_of
    from stone_client.server.sequences import find_sequence

    with connected(server) as api:
        item = find_sequence(api, sequence)
        sets = label_sets_of(api, item["id"])
    if as_json:
        echo_json({"sequence": item["name"], "label_sets": sets})
        return
    show(label_set_table(item["name"], sets))
