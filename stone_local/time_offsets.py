"""The option `--time-offset lidar=-18s`: how much is added to the stamps of the LiDAR, or of the pose source."""

import re
from collections.abc import Sequence
from decimal import Decimal
from typing import Annotated

import typer

PARTS = ("lidar", "pose")
UNITS_NS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}
MOST_NS = 10**12
CHOICE = re.compile(r"(?P<part>[a-z]+)=(?P<number>[+-]?\d{1,13}(\.\d{1,9})?)(?P<unit>ns|us|ms|s)")

TimeOffsetOption = Annotated[
    list[str],
    typer.Option(
        "--time-offset",
        metavar="PART=TIME",
        help="Add to the stamps of lidar or pose, as in lidar=-18s or pose=12.5ms; repeatable.",
    ),
]


def chosen_offsets(choices: Sequence[str]) -> dict[str, int]:
    """Nanoseconds by part. Raises `typer.BadParameter`."""
    chosen: dict[str, int] = {}
    for choice in choices:
        found = CHOICE.fullmatch(choice)
        if found is None or found["part"] not in PARTS:
            raise typer.BadParameter(
                f"{choice[:80]!r} is not a time offset; write lidar=-18s or pose=12.5ms (parts: {', '.join(PARTS)}; "
                f"units: {', '.join(UNITS_NS)})"
            )
        offset_ns = int(Decimal(found["number"]) * UNITS_NS[found["unit"]])
        if abs(offset_ns) > MOST_NS:
            raise typer.BadParameter(f"{choice[:80]!r} is more than {MOST_NS / 1e9:g} s; is the unit right?")
        chosen[found["part"]] = offset_ns
    return chosen
