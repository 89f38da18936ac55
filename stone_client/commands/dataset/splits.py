"""`stone splits`: which sequence is in train, val or test; proposed by a solver, put by an administrator."""

import re
from pathlib import Path
from typing import Annotated

import typer

from stone_client.options import ServerOption
from stone_client.streams import JsonOption, echo_json

SIZES = re.compile(r"(\d{1,4}),(\d{1,4}),(\d{1,4})")
REFUSED = 1

ProposeOption = Annotated[
    str | None, typer.Option(metavar="TRAIN,VAL,TEST", help="Propose splits of these sizes, such as 31,7,5.")
]
LeaveOutOption = Annotated[
    list[str] | None,
    typer.Option("--leave-out", metavar="SEQUENCE", help="Exclude this sequence from the proposal; repeatable."),
]
PutOption = Annotated[
    Path | None,
    typer.Option(metavar="FILE", exists=True, dir_okay=False, help="Save the splits of this JSON file."),
]
ReasonOption = Annotated[str, typer.Option(metavar="TEXT", help="Reason, recorded in the audit log.")]


def splits(
    propose: ProposeOption = None,
    leave_out: LeaveOutOption = None,
    put: PutOption = None,
    reason: ReasonOption = "put by the stone command",
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show the splits and their findings, propose new ones, or save those of a file."""
    from stone_client.connection import connected
    from stone_client.server.splits import current, proposal, put_file, show_splits

    if propose is not None and put is not None:
        raise typer.BadParameter("propose first, review, then save with --put; not both at once", param_hint="--put")
    sizes = _sizes(propose) if propose is not None else None
    with connected(server) as api:
        if sizes is not None:
            record = proposal(api, sizes, leave_out or [])
        elif put is not None:
            record = put_file(api, put, reason)
        else:
            record = current(api)
    if as_json:
        echo_json(record)
    show_splits(record, as_json=as_json)
    if record.get("conflict"):
        raise typer.Exit(REFUSED)


def _sizes(text: str) -> tuple[int, int, int]:
    found = SIZES.fullmatch(text.replace(" ", ""))
    if found is None:
        raise typer.BadParameter(f"{text!r} is not three whole numbers, such as 31,7,5", param_hint="--propose")
    train, val, test = (int(part) for part in found.groups())
    return train, val, test
