"""The choice of a recording's topics for synchronisation; if two topics fit, neither is guessed.

**Conventions.** The pose source is the requested topic, else NovAtel INSPVA(X), else nav_msgs/Odometry, else /tf, else
geometry_msgs/Pose(WithCovariance)Stamped, else NavSatFix with an Imu. The request `kiss-icp` selects the LiDAR itself
(`stone_recordings.poses.kiss_odometry`). The request `course:TOPIC` uses the topic's positions and takes the heading
from the course over ground. If a file of poses is given, no topic is chosen. Topics without messages count as absent.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from stone.errors import PlatformFaultError, Refused
from stone_recordings.bags.bag import Bag, Topic
from stone_recordings.bags.errors import IngestError
from stone_recordings.messages.types.cdr import NS_PER_S
from stone_recordings.sync.errors import ambiguous_topics, no_lidar, no_pose_source
from stone_recordings.topics.cloud_samples import sample_cloud
from stone_recordings.topics.profiles import Candidate
from stone_recordings.topics.roles import (
    POINT_CLOUD,
    POSE_ROLES,
    Role,
    TopicFacts,
    holds_sweeps,
    likely_lidars,
    of_pose_role,
    role_of,
    with_plausible_rate,
)
from stone_recordings.topics.unread_topics import not_read, unread_points

BESTPOS = "novatel_oem7_msgs/msg/BESTPOS"
KISS_ICP = "kiss-icp"
COURSE = "course:"  # prefix of a topic whose positions are used with the course over ground as heading
STRIDE = 10  # messages over which a rate is measured
ROLE_OF_SWEEPS: Role = "lidar"
ASSOCIATED_ROLES: tuple[Role, ...] = ("camera", "radar", "imu")


@dataclass(frozen=True)
class AskedTopics:
    """Topics requested by name instead of by role; with `has_pose_file` no pose topic is chosen."""

    lidar: str | None = None
    pose: str | None = None
    imu: str | None = None
    has_pose_file: bool = False

    @staticmethod
    def of_roles(topics: Mapping[str, str], *, has_pose_file: bool = False) -> "AskedTopics":
        """Return the topics that a profile names by role."""
        return AskedTopics(topics.get("lidar"), topics.get("pose"), topics.get("imu"), has_pose_file)


@dataclass(frozen=True)
class Sources:
    """`pose_role` is the way to read `pose`: "lidar" is odometry from the sweeps, "file" a file of poses.

    `attitude` is the IMU that turns a receiver's positions into poses; with `is_course` the course over ground does.
    `associated` are the topics that frames point into, with their role.
    """

    lidar: Topic
    pose: Topic
    pose_role: Role | Literal["file"]
    fixes: Topic | None
    tf_static: tuple[str, ...]
    associated: tuple[tuple[Topic, Role], ...]
    attitude: Topic | None = None
    is_course: bool = False

    @property
    def scanned(self) -> tuple[str, ...]:
        """The topics whose header stamps are read."""
        return (self.lidar.name, *(topic.name for topic, _ in self.associated))

    @property
    def whole(self) -> tuple[str, ...]:
        """The topics whose messages are all read whole; they are small."""
        fixes = (self.fixes.name,) if self.fixes is not None and self.pose_role == "ins" else ()
        poses = (self.pose.name,) if self.pose_role not in ("lidar", "file") else ()
        turns = (self.attitude.name,) if self.attitude is not None else ()
        return (*self.tf_static, *fixes, *poses, *turns)


def choose_sources(bag: Bag, asked: AskedTopics) -> Sources:
    """Choose the topics of a recording. Raises `TOP-101`, `SYN-502`, `TOP-110`, `TOP-104`."""
    topics = {topic.name: topic for topic in bag.topics if topic.count and topic.encoding == "cdr"}
    roles = [candidate_of(bag, topic) for topic in topics.values()]
    lidar = _lidar(roles, asked.lidar)
    asked_pose = asked.pose.removeprefix(COURSE) if asked.pose else None
    is_course = asked_pose != asked.pose
    pose = lidar if asked.has_pose_file or asked.pose == KISS_ICP else _pose(roles, asked_pose)
    if is_course and pose.role == "ins":
        raise Refused("TOP-104", f"{pose.name} is an INS and has its own attitude: use --odometry {pose.name}")
    role_of_lidar = "file" if asked.has_pose_file else ROLE_OF_SWEEPS
    attitude = _attitude(roles, asked.imu) if pose.role == "gnss" and not is_course else None
    return Sources(
        lidar=topics[lidar.name],
        pose=topics[pose.name],
        pose_role=role_of_lidar if pose is lidar else pose.role,
        fixes=next((topic for topic in topics.values() if topic.type == BESTPOS), None),
        tf_static=tuple(topic.name for topic in roles if topic.role == "tf_static"),
        associated=tuple((topics[topic.name], topic.role) for topic in roles if topic.role in ASSOCIATED_ROLES),
        attitude=topics[attitude.name] if attitude else None,
        is_course=is_course and pose is not lidar,
    )


def candidate_of(bag: Bag, topic: Topic) -> Candidate:
    """Return the topic with its role; unreadable points disqualify this topic alone."""
    rate_hz, facts = _rate_hz(bag.log_times_ns(topic.name)), _facts(bag, topic)
    role, problem = role_of(facts), facts.problem
    return Candidate(topic.name, topic.type, role, topic.count, rate_hz, "", facts.point_count, problem)


def _rate_hz(log_times_ns: NDArray[np.int64]) -> float | None:
    """Return the rate of most messages, without pauses, bursts or clock jumps; None for a single message."""
    stride = min(STRIDE, len(log_times_ns) - 1)
    span_ns = float(np.median(log_times_ns[stride:] - log_times_ns[:-stride])) if stride > 0 else 0.0
    return stride * NS_PER_S / span_ns if span_ns > 0 else None


def _facts(bag: Bag, topic: Topic) -> TopicFacts:
    if not holds_sweeps(topic.name, topic.type):
        return TopicFacts(topic.name, topic.type, None)
    try:
        cloud = sample_cloud(bag, topic)
    except PlatformFaultError:
        raise
    except IngestError as error:
        return TopicFacts(topic.name, topic.type, None, problem=str(error))
    fields = frozenset(cloud.points.dtype.names or ())
    return TopicFacts(topic.name, topic.type, None, fields, len(cloud.points))


def _lidar(roles: list[Candidate], name: str | None) -> Candidate:
    if name is not None:
        fitting = [topic for topic in roles if topic.type == POINT_CLOUD or topic.role == "lidar"]
        return _asked(roles, name, fitting, f"{POINT_CLOUD} or packets that can be decoded")
    lidars = [topic for topic in roles if topic.role == "lidar"]
    if not lidars:
        unread = unread_points(roles)
        raise no_lidar(not_read(unread) if unread else "")
    return _only("lidar", likely_lidars(lidars), "--lidar")


def _pose(roles: list[Candidate], name: str | None) -> Candidate:
    fitting = [topic for topic in roles if topic.role in POSE_ROLES]
    if name is not None:
        fitting = [topic for topic in fitting if of_pose_role(topic.role, [topic])]
        return _asked(roles, name, fitting, "nav_msgs/msg/Odometry, INSPVA(X), /tf, PoseStamped or NavSatFix")
    has_imu = any(topic.role == "imu" for topic in roles)
    for wanted in POSE_ROLES:
        topics = of_pose_role(wanted, [topic for topic in fitting if topic.role == wanted])
        if topics and (wanted != "gnss" or has_imu):
            return _only(wanted, topics, "--odometry")
    raise no_pose_source([f"{topic.name} ({topic.type})" for topic in roles])


def _attitude(roles: list[Candidate], name: str | None) -> Candidate:
    """Return the IMU beside a receiver. Raises `SYN-502`, `TOP-110`, `TOP-104`."""
    imus = [topic for topic in roles if topic.role == "imu"]
    if name is not None:
        return _asked(roles, name, imus, "sensor_msgs/msg/Imu")
    if not imus:
        raise no_pose_source([f"{topic.name} ({topic.type})" for topic in roles])
    return _only("imu", with_plausible_rate("imu", imus), "--topic imu=TOPIC")


def _asked(roles: list[Candidate], name: str, fitting: list[Candidate], expected: str) -> Candidate:
    for topic in fitting:
        if topic.name == name:
            return topic
    mistake = next((f"is of type {topic.type}" for topic in roles if topic.name == name), "has no messages here")
    names = ", ".join(topic.name for topic in fitting[:6]) or "there is none"
    raise Refused("TOP-104", f"topic {name!r} {mistake}; expected {expected} ({names})")


def _only(role: Role, topics: Sequence[Candidate], option: str) -> Candidate:
    if len(topics) > 1:
        raise ambiguous_topics(role, [topic.name for topic in topics], option)
    return topics[0]
