"""`stone recover`: the intact messages of a damaged recording, in a new file."""

from pathlib import Path
from typing import Annotated

import typer

from stone_client.choices import in_folder
from stone_client.options import BagArgument
from stone_client.streams import JsonOption, echo_findings, echo_json

OutputOption = Annotated[
    Path,
    typer.Option("-o", "--output", metavar="OUT.mcap", dir_okay=False, callback=in_folder, help="Output recording."),
]


def recover(bag: BagArgument, output: OutputOption, as_json: JsonOption = False) -> None:
    """Recover all intact messages of a truncated, damaged or unindexed recording into a new MCAP file.

    The original is only read; stderr lists the losses.
    """
    from stone_recordings.bags.recovery.recovery import recover as recover_bag

    recovery = recover_bag(bag, output)
    if as_json:
        echo_json(recovery.as_record())
    else:
        typer.echo(output)
    echo_findings((recovery.finding,))
