"""`stone dataset splits propose`: splits of given sizes from the server's solver."""

import re
from typing import Annotated

import typer

from stone_client.options import ServerOption
from stone_client.refusals import REFUSED
from stone_client.streams import JsonOption, echo_json

SIZES = re.compile(r"(\d{1,4}),(\d{1,4}),(\d{1,4})")

SizesArgument = Annotated[
    str, typer.Argument(metavar="TRAIN,VAL,TEST", help="Numbers of sequences in train, val and test, such as 31,7,5.")
]
LeaveOutOption = Annotated[
    list[str] | None,
    typer.Option("--leave-out", metavar="SEQUENCE", help="Exclude this sequence from the proposal; repeatable."),
]


def propose(
    sizes: SizesArgument, leave_out: LeaveOutOption = None, server: ServerOption = None, as_json: JsonOption = False
) -> None:
    """Propose splits of these sizes; nothing is saved. Exit code 1 if the rules allow none."""
    from stone_client.connection import connected
    from stone_client.server.splits import proposal, show_splits

    chosen = _sizes(sizes)
    with connected(server) as api:
        record = proposal(api, chosen, leave_out or [])
    if as_json:
        echo_json(record)
    show_splits(record, as_json=as_json)
    if record.get("conflict"):
        raise typer.Exit(REFUSED)


def _sizes(text: str) -> tuple[int, int, int]:
    match = SIZES.fullmatch(text.replace(" ", ""))
    if match is None:
        raise typer.BadParameter(f"{text!r} is not three whole numbers, such as 31,7,5", param_hint="TRAIN,VAL,TEST")
    train, val, test = (int(part) for part in match.groups())
    return train, val, test
