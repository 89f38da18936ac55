"""`--clock-offset`: what is known of the clocks of several recordings of one run."""

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
    """Nanoseconds by name of file. Raises `typer.BadParameter`."""
    chosen: dict[str, int] = {}
    for choice in choices:
        found = CHOICE.fullmatch(choice)
        offset_ns = 0 if found is None else int(Decimal(found["number"]) * UNITS_NS[found["unit"] or "s"])
        if found is None or abs(offset_ns) > MOST_OFFSET_NS:
            raise typer.BadParameter(
                f"{choice[:80]!r} is not the clock offset of a recording; write cameras.mcap=-80ms, or "
                "cameras.mcap=-0.080 in seconds",
                param_hint="--clock-offset",
            )
        chosen[Path(found["name"]).name] = offset_ns
    return chosen


def clock_offsets_body(choices: Sequence[str]) -> dict[str, dict[str, str]]:
    """Return the offsets as a request to process has them, to the nanosecond. Raises `typer.BadParameter`."""
    offsets_ns = chosen_clock_offsets(choices)
    return (
        {"clock_offsets_s": {name: str(Decimal(ns).scaleb(-9)) for name, ns in offsets_ns.items()}}
        if offsets_ns
        else {}
    )
