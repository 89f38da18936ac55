"""The topics whose quality is measured, and the names of the cameras.

**Conventions.** Roles are those of the inspection. A number is bounded: nobody mounts more, and a recording that
declares thousands of cameras is not worth hours.
"""

from stone_recordings.bags.bag import Topic
from stone_recordings.report.inspection import Inspection
from stone_recordings.topics.channels import channel_of_words
from stone_recordings.topics.roles import Role

MOST_TOPICS_OF_A_ROLE = 12
CAMERA_RING = ("CAM_FRONT_LEFT", "CAM_FRONT", "CAM_FRONT_RIGHT", "CAM_BACK_LEFT", "CAM_BACK", "CAM_BACK_RIGHT")


def of_role(inspection: Inspection, *roles: Role) -> list[Topic]:
    """The first topics of these roles that have messages which can be decoded at all."""
    found = [one.topic for one in inspection.topics if one.role in roles and one.topic.count]
    return [topic for topic in found if topic.encoding == "cdr"][:MOST_TOPICS_OF_A_ROLE]


def cameras_of(inspection: Inspection) -> list[tuple[Topic, str]]:
    """Topic and channel ("" where nothing names one): front above back, left to right, then the others by name."""
    channel_of_topic = {
        topic: part for part, topic in inspection.assignment.channels.items() if part.startswith("CAM_")
    }
    named = [
        (topic, channel_of_topic.get(topic.name) or channel_of_words("camera", topic.name) or "")
        for topic in of_role(inspection, "camera")
    ]
    return sorted(named, key=lambda one: (_place(one[1]), one[0].name))


def _place(channel: str) -> int:
    return CAMERA_RING.index(channel) if channel in CAMERA_RING else len(CAMERA_RING)
