"""`stone admin audit`: list and verify the audit log."""

from itertools import islice
from typing import Annotated

import typer

from stone_client.options import ServerOption
from stone_client.record_tables import echo_records
from stone_client.streams import JsonOption, echo_json

COLUMNS = {"logged": "logged_at", "actor": "actor", "act": "act", "subject": "subject_id", "reason": "reason"}
BROKEN = 1


def audit(
    act: Annotated[
        str | None, typer.Option(metavar="ACT", help="Only entries of this act, such as phase.change.")
    ] = None,
    actor: Annotated[str | None, typer.Option(metavar="USER", help="Only entries of this user.")] = None,
    subject: Annotated[
        str | None, typer.Option(metavar="ID", help="Only entries about the object with this id.")
    ] = None,
    limit: Annotated[int, typer.Option(metavar="N", min=1, max=100_000, help="Number of entries, newest first.")] = 100,
    is_verification: Annotated[bool, typer.Option("--verify", help="Verify the log's chain of hashes.")] = False,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """List the audit log, newest first, or verify that no entry was changed or removed."""
    from stone_client.connection import administering

    choices = {"act": act, "actor": actor, "subject_id": subject}
    query = {key: value for key, value in choices.items() if value is not None}
    if is_verification and query:
        raise typer.BadParameter("--verify always checks the whole log", param_hint="--verify")
    with administering(server) as api:
        if not is_verification:
            entries = list(islice(api.pages("/admin/audit-log", **query), limit))
            echo_records("entries", entries, COLUMNS, as_json=as_json)
            return
        record = api.read("/admin/audit-log/verification")
    if as_json:
        echo_json(record)
    elif record["is_whole"]:
        typer.echo(f"whole: {record['lines']} entries, last hash {record['head_hash']}")
    else:
        typer.echo(f"BROKEN at entry {record['first_broken']} of {record['lines']}")
    if not record["is_whole"]:
        raise typer.Exit(BROKEN)
