"""`--clock-offset`: the known clock offsets between several recordings of one run."""

import re
from collections.abc import Sequence
from decimal import Decimal
from pathlib import Path
from typing import Annotated

import typer

from stone_files.joined_file import MOST_OFFSET_NS

UNITS_NS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}
CHOICE = re.compile(r"(?P<name>.+)=(?P<number>[+-]?\d{1,19}(\.\d{1,9})?)(?P<unit>ns|us|ms|s|)")

ClockOffsetOption = Annotated[
    list[str],
    typer.Option(
        "--clock-offset",
        metavar="FILE=TIME",
        help="Clock offset to add to the stamps of a recording instead of the measured offset, such as "
        "cameras.mcap=-80ms (default unit: s); repeatable.",
    ),
]


def chosen_clock_offsets(choices: Sequence[str]) -> dict[str, int]:
    """Return the offsets in nanoseconds by file name. Raises `typer.BadParameter`."""
    chosen: dict[str, int] = {}
    for choice in choices:
        match = CHOICE.fullmatch(choice)
        offset_ns = 0 if match is None else int(Decimal(match["number"]) * UNITS_NS[match["unit"] or "s"])
        if match is None or abs(offset_ns) > MOST_OFFSET_NS:
            raise typer.BadParameter(
                f"{choice[:80]!r} is not the clock offset of a recording; write cameras.mcap=-80ms, or "
                "cameras.mcap=-0.080 in seconds",
                param_hint="--clock-offset",
            )
        chosen[Path(match["name"]).name] = offset_ns
    return chosen


def clock_offsets_body(choices: Sequence[str]) -> dict[str, dict[str, str]]:
    """Return the offsets as the body of a processing request, to the nanosecond. Raises `typer.BadParameter`."""
    offsets_ns = chosen_clock_offsets(choices)
    return (
        {"clock_offsets_s": {name: str(Decimal(ns).scaleb(-9)) for name, ns in offsets_ns.items()}}
        if offsets_ns
        else {}
    )
