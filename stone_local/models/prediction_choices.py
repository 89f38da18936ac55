"""The inputs of `stone model predict`: exports and a manifest, or a recording and its calibration, never both."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import typer


@dataclass(frozen=True)
class RecordingFiles:
    """A recording, its calibration, and the name of its sequence."""

    bag: Path
    calibration: Path
    name: str


def refuse_contradictions(inputs: list[Path] | None, bag: Path | None, of_recordings: Mapping[str, object]) -> None:
    """Check that the inputs fit together. Raises `typer.BadParameter`.

    `of_recordings` are the options by name that require --bag, empty if they are not given.
    """
    if inputs and bag is not None:
        raise typer.BadParameter("frames come from INPUTS or from a recording, not from both", param_hint="--bag")
    if not inputs and bag is None:
        raise typer.BadParameter("give exports to predict, or a recording with --bag", param_hint="INPUTS...")
    if bag is None:
        option = next((name for name, value in of_recordings.items() if value), None)
        if option is not None:
            raise typer.BadParameter("it applies to recordings and requires --bag", param_hint=option)
    elif of_recordings["--calibration"] is None:
        raise typer.BadParameter("a recording requires the calibration of its sensors", param_hint="--calibration")
