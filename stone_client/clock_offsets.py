"""`--clock-offset`: what is known of the clocks of several recordings of one run."""

import re
from collections.abc import Sequence
from decimal import Decimal
from pathlib import Path
from typing import Annotated

import typer

from stone_files.joined_file import MOST_OFFSET_NS

CHOICE = re.compile(r"(?P<name>.+)=(?P<seconds>[+-]?\d{1,11}(\.\d{1,9})?)s?")

ClockOffsetOption = Annotated[
    list[str],
    typer.Option(
        "--clock-offset",
        metavar="FILE=SECONDS",
        help="Add this offset to the stamps of a recording instead of the measured one; repeatable.",
    ),
]


def chosen_clock_offsets(choices: Sequence[str]) -> dict[str, int]:
    """Nanoseconds by name of file. Raises `typer.BadParameter`."""
    chosen: dict[str, int] = {}
    for choice in choices:
        found = CHOICE.fullmatch(choice)
        if found is None or abs(Decimal(found["seconds"])) * 10**9 > MOST_OFFSET_NS:
            raise typer.BadParameter(
                f"{choice[:80]!r} is no offset of a recording; write cameras.mcap=-0.080 (seconds)",
                param_hint="--clock-offset",
            )
        chosen[Path(found["name"]).name] = int(Decimal(found["seconds"]) * 10**9)
    return chosen


def clock_offsets_body(choices: Sequence[str]) -> dict[str, dict[str, str]]:
    """Return the offsets as a request to process has them, to the nanosecond. Raises `typer.BadParameter`."""
    offsets_ns = chosen_clock_offsets(choices)
    return (
        {"clock_offsets_s": {name: str(Decimal(ns).scaleb(-9)) for name, ns in offsets_ns.items()}}
        if offsets_ns
        else {}
    )
