"""Profiles of topics, and what they resolve to, over the wire."""

from datetime import datetime
from typing import Annotated, Any

from pydantic import Field, StringConstraints

from api.schemas.base import PLAIN, Answer, Body, example
from api.schemas.sequences.calibrations import FindingItem
from stone_recordings.topics.profiles import LONGEST_TOPIC, MOST_TOPICS

TOPICS_EXAMPLE = {"lidar": "/lidar_points", "pose": "/novatel/oem7/inspvax", "CAM_FRONT": "/camera/front/image_raw"}
ITEM_EXAMPLE: dict[str, Any] = {
    "platform": "warthog-1",
    "topics": TOPICS_EXAMPLE,
    "revision": 1,
    "created_at": "2026-05-03T09:12:44.120000Z",
}
Part = Annotated[str, StringConstraints(pattern=r"^(lidar|pose|imu|(CAM|RADAR)(_[A-Z0-9]+){1,4})$", max_length=64)]
TopicName = Annotated[str, StringConstraints(pattern=PLAIN, min_length=1, max_length=LONGEST_TOPIC)]


class ProfileBody(Body):
    """The topic of each part that is chosen; the others are resolved from each recording."""

    model_config = example(topics=TOPICS_EXAMPLE)

    topics: Annotated[dict[Part, TopicName], Field(max_length=MOST_TOPICS)]


class ProfileItem(Answer):
    """The topics chosen for a platform; `revision` is its ETag."""

    model_config = example(**ITEM_EXAMPLE)

    platform: str
    topics: dict[str, str]
    revision: int
    created_at: datetime


class RolesAnswer(Answer):
    """Which topic of a recording would play which part; what could not be told is in `findings`."""

    model_config = example(platform="warthog-1", chosen={}, channels=TOPICS_EXAMPLE, findings=[])

    platform: str
    chosen: dict[str, str]
    channels: dict[str, str]
    findings: list[FindingItem]
