"""The options `--poses FILE --poses-frame FRAME`: poses from a file beside the recording."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from stone_recordings.poses.file_poses import PoseFile

PosesOption = Annotated[
    Path | None,
    typer.Option(
        "--poses", metavar="FILE", exists=True, dir_okay=False, help="The poses: TUM (stamped), or KITTI (one a sweep)."
    ),
]
PosesFrameOption = Annotated[
    str,
    typer.Option(
        "--poses-frame",
        metavar="FRAME",
        help="Robot frame of the poses: base_link or a sensor's; default: the robot's base.",
    ),
]


def chosen_poses(poses: Path | None, frame: str, odometry: str | None = None) -> "PoseFile | None":
    """The file, None without. Raises `typer.BadParameter` where a topic is asked for as well."""
    from stone_recordings.poses.file_poses import PoseFile

    if poses is not None and odometry is not None:
        raise typer.BadParameter(
            f"poses come from {poses.name} or from {odometry}; leave one out", param_hint="--poses"
        )
    return None if poses is None else PoseFile(poses, frame)
