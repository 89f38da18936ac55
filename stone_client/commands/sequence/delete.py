"""`stone sequence delete`: a sequence with its recordings and labels."""

import typer

from stone_client.confirmation import DryRunOption, PermanentAct, YesOption, confirm
from stone_client.options import SequenceArgument, ServerOption
from stone_client.streams import JsonOption, echo_json


def delete(
    sequence: SequenceArgument,
    is_confirmed: YesOption = False,
    is_dry_run: DryRunOption = False,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Delete a sequence with its recordings and labels, and stop its jobs. Published versions keep their content."""
    from stone_client.connection import connected
    from stone_client.server.sequences import find_sequence

    with connected(server) as api:
        item = find_sequence(api, sequence)
        recordings = len(list(api.pages(f"/sequences/{item['id']}/recordings")))
        labels = len(list(api.pages(f"/sequences/{item['id']}/label-sets")))
        held = f"{recordings} recordings and {labels} label sets"
        act = PermanentAct(f"delete sequence {item['name']} ({item['id']})", f"its {held} cannot be restored")
        details = {"id": item["id"], "recordings": recordings, "label_sets": labels}
        confirm(act, details, is_given=is_confirmed, is_dry_run=is_dry_run, as_json=as_json)
        api.send("DELETE", f"/sequences/{item['id']}", headers={"If-Match": f'"{item["revision"]}"'})
    if as_json:
        echo_json({"deleted": item["id"]})
    else:
        typer.echo(f"deleted {item['name']} ({item['id']})")
