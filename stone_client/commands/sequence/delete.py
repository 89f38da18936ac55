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
    """Delete a sequence with its recordings and labels; its jobs stop. Published versions keep what they name."""
    from stone_client.connection import connected
    from stone_client.server.sequences import find_sequence

    with connected(server) as api:
        found = find_sequence(api, sequence)
        recordings = len(list(api.pages(f"/sequences/{found['id']}/recordings")))
        labels = len(list(api.pages(f"/sequences/{found['id']}/label-sets")))
        held = f"{recordings} recordings and {labels} label sets"
        act = PermanentAct(f"delete sequence {found['name']} ({found['id']})", f"its {held} cannot be restored")
        details = {"id": found["id"], "recordings": recordings, "label_sets": labels}
        confirm(act, details, is_given=is_confirmed, is_dry_run=is_dry_run, as_json=as_json)
        api.send("DELETE", f"/sequences/{found['id']}", headers={"If-Match": f'"{found["revision"]}"'})
    if as_json:
        echo_json({"deleted": found["id"]})
    else:
        typer.echo(f"deleted {found['name']} ({found['id']})")
