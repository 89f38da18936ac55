"""The topics to choose from for processing: those of a sequence's recordings that can be the odometry, or the LiDAR.

**Conventions.** Read from the inspections of registered recordings; a topic in several recordings is one choice with
added messages. A choice is a topic that processing accepts (`stone_recordings/topics/sources.py`) and the API allows.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from api.schemas.sequences.sequences import LONGEST_TOPIC, TOPIC_PATTERN
from services.runtime.orm import Recording

ODOMETRY_ROLES = ("ins", "odometry", "tf", "pose", "gnss")
POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
POSITION_TYPES = ("sensor_msgs/msg/NavSatFix",)
MOST_READ = 50


@dataclass(frozen=True)
class TopicChoice:
    """A topic, its type without the package, and how many messages it has."""

    name: str
    type: str
    messages: int


@dataclass(frozen=True)
class TopicChoices:
    """The choices; `automatic_…` is the default topic, "" if unknown.

    `is_read` is whether a recording has been read.
    """

    is_read: bool = False
    odometry: tuple[TopicChoice, ...] = ()
    lidar: tuple[TopicChoice, ...] = ()
    automatic_odometry: str = ""
    automatic_lidar: str = ""


def topic_choices_of(session: Session, sequence_id: str) -> TopicChoices:
    """Return the choices for a sequence."""
    registered = select(Recording.inspection).where(
        Recording.sequence_id == sequence_id, Recording.state == "registered"
    )
    return choices_in(session.scalars(registered.order_by(Recording.id).limit(MOST_READ)).all())


def choices_in(inspections: Iterable[dict[str, Any] | None]) -> TopicChoices:
    """Return the choices in the records of inspections; None is a recording without one."""
    read = list(inspections)
    records = [record for record in read if record]
    topics = [topic for record in records for topic in record.get("topics", [])]
    channels = [record.get("channels", {}) for record in records]
    return TopicChoices(
        bool(read),
        _merged(topic for topic in topics if _may_be_odometry(topic)),
        _merged(topic for topic in topics if topic["role"] == "lidar" or topic["type"] == POINT_CLOUD),
        _only({resolved["pose"] for resolved in channels if "pose" in resolved}),
        _only({resolved["lidar"] for resolved in channels if "lidar" in resolved}),
    )


def _may_be_odometry(topic: dict[str, Any]) -> bool:
    is_position = topic["role"] != "gnss" or topic["type"] in POSITION_TYPES
    return topic["role"] in ODOMETRY_ROLES and is_position


def _merged(topics: Iterable[dict[str, Any]]) -> tuple[TopicChoice, ...]:
    merged: dict[str, TopicChoice] = {}
    for topic in topics:
        name = topic["name"]
        before = merged[name].messages if name in merged else 0
        if len(name) <= LONGEST_TOPIC and re.fullmatch(TOPIC_PATTERN, name):
            merged[name] = TopicChoice(name, topic["type"].rpartition("/")[2], before + topic["count"])
    return tuple(merged[name] for name in sorted(merged))


def _only(topics: set[str]) -> str:
    return topics.pop() if len(topics) == 1 else ""
