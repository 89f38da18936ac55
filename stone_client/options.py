"""Options that several commands share, with the same words and behaviour."""

import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from stone_base.newer_python import StrEnum
from stone_client.choices import grids, layouts, one_of

BagArgument = Annotated[
    Path,
    typer.Argument(
        metavar="BAG",
        exists=True,
        readable=True,
        help="The recording: an .mcap, .db3 or ROS 1 .bag file, or the folder of a split bag.",
    ),
]
RunArgument = Annotated[
    list[Path],
    typer.Argument(
        metavar="BAG...",
        exists=True,
        readable=True,
        help="The recording: an .mcap, .db3 or ROS 1 .bag file, or the folder of a split bag; several of one run.",
    ),
]
SubmissionArgument = Annotated[
    Path,
    typer.Argument(
        metavar="SUB.zip", exists=True, dir_okay=False, help="Submission: a zip of <frame_token>.npz files."
    ),
]
ManifestOption = Annotated[
    Path, typer.Option("--manifest", metavar="M.json", exists=True, dir_okay=False, help="Manifest of the frames.")
]
WorkersOption = Annotated[
    int | None, typer.Option(min=1, max=256, help="Number of processes.", show_default="one per core")
]
ServerOption = Annotated[
    str | None, typer.Option("--server", metavar="URL", help="Server (default: STONE_URL, or the last login).")
]
BenchmarkArgument = Annotated[str, typer.Argument(metavar="BENCHMARK", help="A benchmark's name.")]
PhaseArgument = Annotated[str, typer.Argument(metavar="PHASE", help="A phase of the benchmark, such as val or test.")]
BenchmarkOption = Annotated[str, typer.Option("--benchmark", metavar="B", help="A benchmark's name.")]
PhaseOption = Annotated[
    str, typer.Option("--phase", metavar="P", help="A phase of the benchmark, such as val or test.")
]
SequenceArgument = Annotated[str, typer.Argument(metavar="SEQUENCE", help="A sequence's name or id.")]
DatasetLayoutOption = Annotated[
    str | None,
    typer.Option(
        "--layout",
        metavar="NAME",
        help="Layout of the labels: paper, release or occ3d (default: recognised).",
        **one_of(layouts),
    ),
]
DatasetGridOption = Annotated[
    str | None,
    typer.Option(
        "--grid",
        metavar="NAME|FILE",
        help="Grid of the labels: paper, release, occ3d, or a file (default: recognised).",
        **one_of(grids, is_file_too=True),
    ),
]
DatasetClassesOption = Annotated[
    Path | None,
    typer.Option(
        "--classes",
        metavar="FILE",
        exists=True,
        dir_okay=False,
        help="File that maps the labels' numbers to T, P, N and free.",
    ),
]
CalibrationOption = Annotated[
    Path,
    typer.Option("--calibration", metavar="CAL", exists=True, help="Calibration: file, folder or zip."),
]
PARAMETER = re.compile(r"(?P<name>[a-z][a-z0-9_.]*)=(?P<value>[+-]?\d{1,9}(\.\d{1,18})?(e[+-]?\d{1,2})?)", re.ASCII)
ParameterOption = Annotated[
    list[str],
    typer.Option(
        "--parameter",
        metavar="NAME=VALUE",
        help="Set a label parameter, such as reference.outlier_ratio=0.25; repeatable.",
    ),
]


DataOption = Annotated[
    Path | None,
    typer.Option(metavar="DIR", file_okay=False, help="Data folder of the platform.", show_default="stone-data"),
]


class Modality(StrEnum):
    """Sensors that a method uses: cameras, LiDAR, radar, and their combinations."""

    C = "C"
    L = "L"
    R = "R"
    CL = "C+L"
    CR = "C+R"
    LR = "L+R"
    CLR = "C+L+R"


class Ground(StrEnum):
    """Source of the LiDAR's height and tilt: the calibration, or the sweeps."""

    GIVEN = "given"
    AUTO = "auto"


class LabelProfile(StrEnum):
    """The labelling rules: `field` one-sided with the vehicle's limits and heights above the ground nearby; `local` by
    these heights alone; `paper` exactly as published, for reproductions.
    """

    FIELD = "field"
    LOCAL = "local"
    PAPER = "paper"


DEFAULT_PROFILE = LabelProfile.FIELD
ProfileOption = Annotated[
    LabelProfile,
    typer.Option(
        help="field: ground at most as steep and rough as driven, within the vehicle's limits. local: height above "
        "local ground, no limits. paper: absolute elevation, as published."
    ),
]
GridsOption = Annotated[
    list[str],
    typer.Option(
        "--grid",
        metavar="NAME|FILE",
        help="Grid of the labels: paper, release, occ3d, or a JSON file with its name, min_m, voxel_m and "
        "shape (default: paper). Repeat the option to write several grids from one map.",
        **one_of(grids, is_file_too=True),
        show_default=False,
    ),
]
GridOption = Annotated[
    str | None,
    typer.Option(
        "--grid",
        metavar="NAME|FILE",
        help="Grid of the labels: paper, release, occ3d, or a JSON file with its name, min_m, voxel_m and "
        "shape (default: the grid of the files).",
        **one_of(grids, is_file_too=True),
        show_default=False,
    ),
]
OdometryOption = Annotated[
    str | None,
    typer.Option(
        metavar="TOPIC",
        help="Pose source: a topic, kiss-icp, or course:TOPIC (positions of TOPIC, heading from its course). "
        "Default: the best source in the bag.",
    ),
]
GroundOption = Annotated[
    Ground, typer.Option(help="LiDAR height and tilt: from the calibration (given), or measured on the ground (auto).")
]
LidarOption = Annotated[str | None, typer.Option(metavar="TOPIC", help="LiDAR topic, if the bag has several.")]


def chosen_parameters(choices: Sequence[str]) -> dict[str, float]:
    """Return the values by name; a number without point and exponent is an int. Raises `typer.BadParameter`."""
    chosen: dict[str, float] = {}
    for choice in choices:
        match = PARAMETER.fullmatch(choice)
        if match is None:
            raise typer.BadParameter(
                f"{choice[:80]!r} is not NAME=VALUE, such as reference.outlier_ratio=0.25", param_hint="--parameter"
            )
        chosen[match["name"]] = int(match["value"]) if match["value"].isdecimal() else float(match["value"])
    return chosen


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0))
