"""`stone splits`: which sequence is in train, val or test; proposed by a solver, put by an administrator."""

import re
from pathlib import Path
from typing import Annotated

import typer

from stone_client.confirmation import DryRunOption, YesOption, require_confirmation, show_dry_run
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
    is_confirmed: YesOption = False,
    is_dry_run: DryRunOption = False,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show the splits and their findings, propose new ones, or save those of a file."""
    from stone_client.connection import connected
    from stone_client.server.publication import planned_splits, saving, show_splits_plan
    from stone_client.server.splits import current, proposal, put_file, show_splits

    if propose is not None and put is not None:
        raise typer.BadParameter("propose first, review, then save with --put; not both at once", param_hint="--put")
    if is_dry_run and put is None:
        raise typer.BadParameter("only --put changes anything", param_hint="--dry-run")
    sizes = _sizes(propose) if propose is not None else None
    with connected(server) as api:
        if sizes is not None:
            record = proposal(api, sizes, leave_out or [])
        elif put is not None:
            shown_revision = None
            if is_dry_run or not is_confirmed:
                plan = planned_splits(api, put)
                show_splits_plan(plan, as_json=as_json)
                if is_dry_run:
                    show_dry_run(saving(plan), plan, as_json=as_json)
                    raise typer.Exit(0 if plan["can_be_put"] else REFUSED)
                require_confirmation(saving(plan), is_given=False)
                shown_revision = plan["revision"]
            record = put_file(api, put, reason, shown_revision)
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
