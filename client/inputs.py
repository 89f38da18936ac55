"""The options that several commands share, so that they read and behave the same."""

import os
from pathlib import Path
from typing import Annotated

import typer

BagArgument = Annotated[
    Path,
    typer.Argument(
        metavar="BAG", exists=True, readable=True, help="The recording: an .mcap file, a .db3 file or a rosbag2 folder."
    ),
]
SubmissionArgument = Annotated[
    Path, typer.Argument(metavar="SUB.zip", exists=True, dir_okay=False, help="The zip of <frame_token>.npz to judge.")
]
WorkersOption = Annotated[
    int | None, typer.Option(min=1, max=256, help="Processes; as many as cores unless said.", show_default="cores")
]


def cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0))
