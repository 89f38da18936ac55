"""Topic roles chosen on the command line: a saved profile and single overrides.

**Conventions.** A choice has the form PART=TOPIC (`--topic CAM_FRONT=/camera/front/image_raw`), as in the findings.
"""

import re
from collections.abc import Sequence
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from stone_client.clock_offsets import UNITS_NS
from stone_files.joined_file import MOST_OFFSET_NS

if TYPE_CHECKING:
    from stone_recordings.poses.file_poses import PoseFile
    from stone_recordings.topics.profiles import TopicProfile


TopicsOption = Annotated[
    Path | None,
    typer.Option("--topics", metavar="FILE", exists=True, dir_okay=False, help="Saved topic choices of the robot."),
]
TopicOption = Annotated[
    list[str],
    typer.Option(
        "--topic", metavar="PART=TOPIC", help="Topic of a role: lidar, pose, imu, CAM_FRONT, RADAR_LEFT, …; repeatable."
    ),
]
SaveTopicsOption = Annotated[
    Path | None,
    typer.Option("--save-topics", metavar="FILE", dir_okay=False, help="Save the resolved topics for --topics."),
]


def chosen_topics(saved: Path | None, choices: list[str]) -> "TopicProfile":
    """Return the saved profile with the single choices applied. Raises what reading it raises, and `BadParameter`."""
    from stone_recordings.topics.profiles import TopicProfile, read_profile

    profile = read_profile(saved) if saved is not None else TopicProfile()
    made = dict(_choice(text) for text in choices)
    kept = {part: topic for part, topic in profile.topics.items() if topic not in made.values()}
    return TopicProfile({**kept, **made}, profile.platform)


def _choice(text: str) -> tuple[str, str]:
    part, sign, topic = text.partition("=")
    if not sign or not part or not topic:
        raise typer.BadParameter(f"{text!r} is not PART=TOPIC, such as lidar=/lidar_points", param_hint="--topic")
    return part, topic


# The options `--poses FILE --poses-frame FRAME`: poses from a file beside the recording.


PosesOption = Annotated[
    Path | None,
    typer.Option(
        "--poses",
        metavar="FILE",
        exists=True,
        dir_okay=False,
        help="File of poses: TUM (stamped), or KITTI (one per sweep).",
    ),
]
PosesFrameOption = Annotated[
    str,
    typer.Option(
        "--poses-frame",
        metavar="FRAME",
        help="Robot frame of the poses: base_link or a sensor (default: the robot's base).",
    ),
]


def chosen_poses(poses: Path | None, frame: str, odometry: str | None = None) -> "PoseFile | None":
    """Return the file, None without one. Raises `typer.BadParameter` if a topic is given as well."""
    from stone_recordings.poses.file_poses import PoseFile

    if poses is not None and odometry is not None:
        raise typer.BadParameter(
            f"poses come from {poses.name} or from {odometry}; leave one out", param_hint="--poses"
        )
    return None if poses is None else PoseFile(poses, frame)


# The option `--time-offset lidar=-18s`: time to add to the stamps of the LiDAR, or of the pose source.


PARTS = ("lidar", "pose")
CHOICE = re.compile(r"(?P<part>[a-z]+)=(?P<number>[+-]?\d{1,19}(\.\d{1,9})?)(?P<unit>ns|us|ms|s)")

TimeOffsetOption = Annotated[
    list[str],
    typer.Option(
        "--time-offset",
        metavar="PART=TIME",
        help="Time to add to the stamps of lidar or pose, such as lidar=-18s or pose=12.5ms; repeatable.",
    ),
]


def chosen_offsets(choices: Sequence[str]) -> dict[str, int]:
    """Return the offsets in nanoseconds by part. Raises `typer.BadParameter`."""
    chosen: dict[str, int] = {}
    for choice in choices:
        match = CHOICE.fullmatch(choice)
        if match is None or match["part"] not in PARTS:
            raise typer.BadParameter(
                f"{choice[:80]!r} is not a time offset; write lidar=-18s or pose=12.5ms (parts: {', '.join(PARTS)}; "
                f"units: {', '.join(UNITS_NS)})",
                param_hint="--time-offset",
            )
        offset_ns = int(Decimal(match["number"]) * UNITS_NS[match["unit"]])
        if abs(offset_ns) > MOST_OFFSET_NS:
            raise typer.BadParameter(
                f"{choice[:80]!r} is more than {MOST_OFFSET_NS / 1e9:.0f} s; is the unit right?",
                param_hint="--time-offset",
            )
        chosen[match["part"]] = offset_ns
    return chosen
