"""Topic roles chosen on the command line: a saved profile and single overrides.

**Conventions.** A choice reads PART=TOPIC (`--topic CAM_FRONT=/camera/front/image_raw`), as the findings print it.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from stone_recordings.topics.profiles import TopicProfile

TopicsOption = Annotated[
    Path | None,
    typer.Option("--topics", metavar="FILE", exists=True, dir_okay=False, help="The robot's saved choice of topics."),
]
TopicOption = Annotated[
    list[str],
    typer.Option(
        "--topic", metavar="PART=TOPIC", help="One choice: lidar, pose, imu, CAM_FRONT, RADAR_LEFT, …; repeatable."
    ),
]
SaveTopicsOption = Annotated[
    Path | None,
    typer.Option("--save-topics", metavar="FILE", dir_okay=False, help="Save the resolved topics, for --topics."),
]


def chosen_topics(saved: Path | None, choices: list[str]) -> "TopicProfile":
    """The saved profile with the single choices in place. Raises what reading it raises, and `BadParameter`."""
    from stone_recordings.topics.profile_file import read_profile
    from stone_recordings.topics.profiles import TopicProfile

    profile = read_profile(saved) if saved is not None else TopicProfile()
    made = dict(_choice(text) for text in choices)
    kept = {part: topic for part, topic in profile.topics.items() if topic not in made.values()}
    return TopicProfile({**kept, **made}, profile.platform)


def _choice(text: str) -> tuple[str, str]:
    part, sign, topic = text.partition("=")
    if not sign or not part or not topic:
        raise typer.BadParameter(f"{text!r} is not PART=TOPIC, such as lidar=/lidar_points", param_hint="--topic")
    return part, topic
