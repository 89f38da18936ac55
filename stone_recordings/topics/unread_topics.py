"""Topics with a LiDAR's points or a camera's pictures in an unsupported form, and the form to record instead.

**Conventions.** The name of a type reveals its content. TOP-120 names topics of points if another LiDAR is read;
otherwise TOP-101 does. TOP-121 names topics of pictures.
"""

import re
from collections.abc import Iterable, Sequence
from typing import Protocol

from stone.findings import Finding
from stone_recordings.messages.lidars.models import topic_instead
from stone_recordings.topics.roles import Role

# As in sensor_msgs/msg/LaserScan, rslidar_msg/msg/RslidarPacket, foxglove_msgs/msg/CompressedPointCloud.
POINT_TYPE = re.compile(r"point_?cloud|scan|packet|laser|lidar|custommsg|udpframe", re.IGNORECASE)
# Types and topic names of other sensors, of networks and of data derived from points (/ouster/imu_packets).
OTHER = re.compile(r"imu|can_|radar|gnss|gps|novatel|diagnos|statistics|info|marker|ffmpeg|image|video", re.IGNORECASE)
# As in ffmpeg_image_transport_msgs/msg/FFMPEGPacket, foxglove_msgs/msg/CompressedVideo.
VIDEO_TYPE = re.compile(r"ffmpeg|video|theora|h26[45]", re.IGNORECASE)
SHOWN = 4


class UnreadTopic(Protocol):
    """A topic, its role, and the reason why its points are not read ("" if its type is unknown)."""

    @property
    def name(self) -> str: ...
    @property
    def type(self) -> str: ...
    @property
    def role(self) -> Role: ...
    @property
    def count(self) -> int: ...
    @property
    def problem(self) -> str: ...


def unread_points(topics: Iterable[UnreadTopic]) -> list[UnreadTopic]:
    """Return the topics with messages that may hold a LiDAR's points and are not read."""
    return [topic for topic in topics if topic.role == "other" and topic.count and _may_hold_points(topic)]


def not_read(topics: Sequence[UnreadTopic]) -> str:
    """Return a sentence with each topic, its type, and the way out."""
    more = f"; and {len(topics) - SHOWN} more" if len(topics) > SHOWN else ""
    return "; ".join(_not_read(topic) for topic in topics[:SHOWN]) + more


def unread_findings(topics: Iterable[UnreadTopic]) -> tuple[Finding, ...]:
    """Return TOP-120 for each topic of points; if decoding failed, the finding names that reason."""
    return tuple(
        Finding("TOP-120", "info", topic.name, f"{_not_read(topic)}.")
        for topic in unread_points(topics)
        if not topic.problem
    )


def video_findings(topics: Iterable[UnreadTopic]) -> tuple[Finding, ...]:
    """Return TOP-121 for each topic of pictures that are compressed across frames."""
    return tuple(
        Finding(
            "TOP-121",
            "warning",
            topic.name,
            f"{topic.name} ({topic.type}) holds video, which is not read: record Image or CompressedImage (JPEG), or "
            "make them of it by republish of image_transport; frames have no picture of this camera.",
        )
        for topic in topics
        if topic.role == "other" and topic.count and VIDEO_TYPE.search(topic.type)
    )


def _may_hold_points(topic: UnreadTopic) -> bool:
    return bool(topic.problem) or bool(POINT_TYPE.search(topic.type) and not OTHER.search(topic.name + topic.type))


def _not_read(topic: UnreadTopic) -> str:
    why = topic.problem.removeprefix(f"{topic.type}: ") or topic_instead(topic.type)
    return f"{topic.name} ({topic.type}) is not read: {why}"
