"""Which topic of a recording plays which part in its synchronisation; nothing is guessed between two that fit.

**Conventions.** The pose source is the topic asked for, else NovAtel INSPVA(X), else nav_msgs/Odometry, else /tf; asked
for by the name kiss-icp, it is the LiDAR itself (`services.ingest.kiss_odometry`).
Topics without messages count as absent.
"""

from dataclasses import dataclass

from services.ingest.bag import Bag, Topic
from services.ingest.checks import PACKET_TYPES
from services.ingest.messages.pointcloud2 import decode_cloud
from services.ingest.roles import POINT_CLOUD, Role, TopicFacts, role_of
from services.ingest.synchronisation_errors import (
    AmbiguousTopicsError,
    NoLidarError,
    NoPoseSourceError,
    WrongTopicError,
)

BESTPOS = "novatel_oem7_msgs/msg/BESTPOS"
INSPVAX = "novatel_oem7_msgs/msg/INSPVAX"
KISS_ICP = "kiss-icp"
POSE_ROLES: tuple[Role, ...] = ("ins", "odometry", "tf")
ROLE_OF_SWEEPS: Role = "lidar"
ASSOCIATED_ROLES: tuple[Role, ...] = ("camera", "radar", "imu")


@dataclass(frozen=True)
class Sources:
    """`pose_role` says how `pose` is read ("lidar": by odometry from the sweeps).

    `associated` are the topics that frames point into, with their role.
    """

    lidar: Topic
    pose: Topic
    pose_role: Role
    fixes: Topic | None
    tf_static: tuple[str, ...]
    associated: tuple[tuple[Topic, Role], ...]

    @property
    def scanned(self) -> tuple[str, ...]:
        """Topics of which the header stamps are needed."""
        return (self.lidar.name, *(topic.name for topic, _ in self.associated))

    @property
    def whole(self) -> tuple[str, ...]:
        """Topics of which every message is needed; they are small."""
        fixes = (self.fixes.name,) if self.fixes is not None and self.pose_role == "ins" else ()
        poses = (self.pose.name,) if self.pose_role != "lidar" else ()
        return (*self.tf_static, *fixes, *poses)


def choose_sources(bag: Bag, lidar_topic: str | None, odometry_topic: str | None) -> Sources:
    """Raises NoLidarError, NoPoseSourceError, AmbiguousTopicsError, WrongTopicError; what decoding a cloud raises."""
    roles = [(topic, _role(bag, topic)) for topic in bag.topics if topic.count and topic.encoding == "cdr"]
    lidar = _lidar(roles, lidar_topic)
    pose, pose_role = (lidar, ROLE_OF_SWEEPS) if odometry_topic == KISS_ICP else _pose(roles, odometry_topic)
    return Sources(
        lidar=lidar,
        pose=pose,
        pose_role=pose_role,
        fixes=next((topic for topic, _ in roles if topic.type == BESTPOS), None),
        tf_static=tuple(topic.name for topic, role in roles if role == "tf_static"),
        associated=tuple((topic, role) for topic, role in roles if role in ASSOCIATED_ROLES),
    )


def _role(bag: Bag, topic: Topic) -> Role:
    if topic.type != POINT_CLOUD:
        return role_of(TopicFacts(topic.name, topic.type, None))
    cloud = decode_cloud(bag.message(topic.name, topic.count // 2).payload)
    fields = frozenset(cloud.points.dtype.names or ())
    return role_of(TopicFacts(topic.name, topic.type, None, fields, len(cloud.points)))


def _lidar(roles: list[tuple[Topic, Role]], asked: str | None) -> Topic:
    if asked is not None:
        return _asked(roles, asked, [topic for topic, _ in roles if topic.type == POINT_CLOUD], POINT_CLOUD)
    lidars = [topic for topic, role in roles if role == "lidar"]
    if not lidars:
        raise NoLidarError([topic.name for topic, _ in roles if topic.type in PACKET_TYPES])
    return _only("lidar", lidars, "--lidar")


def _pose(roles: list[tuple[Topic, Role]], asked: str | None) -> tuple[Topic, Role]:
    fitting = [(topic, role) for topic, role in roles if role in POSE_ROLES]
    if asked is not None:
        topic = _asked(roles, asked, [topic for topic, _ in fitting], "nav_msgs/msg/Odometry, INSPVA(X) or /tf")
        return topic, next(role for found, role in fitting if found is topic)
    for wanted in POSE_ROLES:
        topics = [topic for topic, role in fitting if role == wanted]
        if wanted == "ins":
            topics = _fullest(topics)
        if topics:
            return _only(wanted, topics, "--odometry"), wanted
    raise NoPoseSourceError([f"{topic.name} ({topic.type})" for topic, _ in roles])


def _fullest(topics: list[Topic]) -> list[Topic]:
    """INSPVA and INSPVAX of one receiver are the same solution: the more frequent, else the one with its quality."""
    if len({topic.type for topic in topics}) < len(topics):
        return topics
    return sorted(topics, key=lambda topic: (-topic.count, topic.type != INSPVAX))[:1]


def _asked(roles: list[tuple[Topic, Role]], asked: str, fitting: list[Topic], expected: str) -> Topic:
    for topic in fitting:
        if topic.name == asked:
            return topic
    found = next((f"is of type {topic.type}" for topic, _ in roles if topic.name == asked), "has no messages here")
    names = ", ".join(topic.name for topic in fitting[:6]) or "there is none"
    raise WrongTopicError(asked, found, f"{expected} ({names})")


def _only(role: Role, topics: list[Topic], option: str) -> Topic:
    if len(topics) > 1:
        raise AmbiguousTopicsError(role, [topic.name for topic in topics], option)
    return topics[0]
