"""The options that several commands share, so that they read and behave the same."""

import os
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

BagArgument = Annotated[
    Path,
    typer.Argument(
        metavar="BAG",
        exists=True,
        readable=True,
        help="The recording: an .mcap, .db3 or ROS 1 .bag file, or a folder of a split one.",
    ),
]
RunArgument = Annotated[
    list[Path],
    typer.Argument(
        metavar="BAG...",
        exists=True,
        readable=True,
        help="The recording: an .mcap, .db3 or ROS 1 .bag file, or a folder of a split one; several of one run.",
    ),
]
SubmissionArgument = Annotated[
    Path,
    typer.Argument(metavar="SUB.zip", exists=True, dir_okay=False, help="The submission: a zip of <frame_token>.npz."),
]
ManifestOption = Annotated[
    Path, typer.Option("--manifest", metavar="M.json", exists=True, dir_okay=False, help="The frames to predict.")
]
WorkersOption = Annotated[
    int | None, typer.Option(min=1, max=256, help="Number of processes; default: one per core.", show_default="cores")
]
ServerOption = Annotated[
    str | None, typer.Option("--server", metavar="URL", help="The server; else STONE_URL, else the last login.")
]
BenchmarkArgument = Annotated[str, typer.Argument(metavar="BENCHMARK", help="A benchmark's name.")]
PhaseArgument = Annotated[str, typer.Argument(metavar="PHASE", help="A phase of it, such as val or test.")]
BenchmarkOption = Annotated[str, typer.Option("--benchmark", metavar="B", help="A benchmark's name.")]
PhaseOption = Annotated[str, typer.Option("--phase", metavar="P", help="A phase of it, such as val or test.")]
SequenceArgument = Annotated[str, typer.Argument(metavar="SEQUENCE", help="A sequence's name or id.")]
CalibrationOption = Annotated[
    Path,
    typer.Option("--calibration", metavar="CAL", exists=True, help="Calibration: file, folder or zip."),
]


DataOption = Annotated[
    Path | None,
    typer.Option(metavar="DIR", file_okay=False, help="Data folder of the platform.", show_default="stone-data"),
]


class Modality(StrEnum):
    """What a method senses with: cameras, LiDAR, radar, and their sums."""

    C = "C"
    L = "L"
    R = "R"
    CL = "C+L"
    CR = "C+R"
    LR = "L+R"
    CLR = "C+L+R"


class Ground(StrEnum):
    """Where the ground lies under the robot: as the calibration says, or as the sweeps show it."""

    GIVEN = "given"
    AUTO = "auto"


class LabelProfile(StrEnum):
    """How height enters the labels: `paper` takes it to the letter, `local` above the ground nearby."""

    PAPER = "paper"
    LOCAL = "local"


ProfileOption = Annotated[
    LabelProfile, typer.Option(help="Height reference: absolute as in the paper, or above local ground.")
]
OdometryOption = Annotated[
    str | None,
    typer.Option(metavar="TOPIC", help="Pose source: a topic, or kiss-icp; default: the best one in the bag."),
]
GroundOption = Annotated[
    Ground, typer.Option(help="LiDAR height and tilt: from the calibration (given), or measured on the ground (auto).")
]
LidarOption = Annotated[str | None, typer.Option(metavar="TOPIC", help="LiDAR topic, if the bag has several.")]


def cores() -> int:
    """The number of cores this process may use."""
    return len(os.sched_getaffinity(0))
