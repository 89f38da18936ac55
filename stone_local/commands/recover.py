"""`stone recover`: the intact messages of a damaged recording, in a new file."""

from pathlib import Path
from typing import Annotated

import typer

from stone_client.options import BagArgument
from stone_client.streams import JsonOption, echo_findings, echo_json

OutOption = Annotated[
    Path, typer.Option("--out", "-o", metavar="OUT.mcap", dir_okay=False, help="The recording to write.")
]


def recover(bag: BagArgument, out: OutOption, as_json: JsonOption = False) -> None:
    """Recover all intact messages of a truncated, damaged or unindexed recording into a new MCAP file.

    The original is only read; what is lost is said on stderr.
    """
    from stone_recordings.bags.recovery.recovery import recover as recover_bag

    recovery = recover_bag(bag, out)
    if as_json:
        echo_json(recovery.as_record())
    else:
        typer.echo(out)
    echo_findings((recovery.finding,))
