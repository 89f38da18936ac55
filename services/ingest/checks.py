"""The findings of an inspection: each one measured here, each with the number that made it.

**Conventions.** `BAG-*` the container, `TOP-*` which topics there are, `TIM-*` their clocks. Nothing is repaired: a
finding says what later stages will do about it, or what to change before the next recording.
"""

from collections.abc import Iterator, Sequence

from services.ingest.bag import Bag, Topic
from services.ingest.messages.pointcloud2 import Cloud, lidar_points
from services.ingest.roles import Role
from services.ingest.timing import Timing
from stone.findings import Finding

Inspected = tuple[Topic, Role, Timing]

PACKET_TYPES = frozenset(
    {
        "hesai_ros_driver/msg/UdpFrame",
        "pandar_msgs/msg/PandarScan",
        "nebula_msgs/msg/NebulaPackets",
        "velodyne_msgs/msg/VelodyneScan",
    }
)
POSE_ROLES: tuple[Role, ...] = ("ins", "odometry", "tf")
SINGLE_ROLES: tuple[Role, ...] = ("lidar", "ins", "odometry")


def container_findings(bag: Bag) -> Iterator[Finding]:
    if not bag.is_indexed:
        yield Finding(
            "BAG-011", "info", "", "No usable index: the whole file was walked. Record without `fastwrite` to avoid it."
        )
    for topic in bag.topics:
        if topic.encoding != "cdr":
            message = f"Encoded as {topic.encoding!r}, only 'cdr' is read: this topic is left out."
            yield Finding("BAG-014", "warning", topic.name, message)


def cloud_findings(topic: Topic, cloud: Cloud) -> Iterator[Finding]:
    """One cloud of a LiDAR topic, looked at in full."""
    points = lidar_points(cloud)
    if points.offset_ns is None and points.time_meaning == "another clock":
        message = "The times of the points are of another clock than the header stamp: deskew is off."
        yield Finding("TOP-102", "warning", topic.name, message)
    elif points.offset_ns is None:
        message = "The points carry no time: deskew is off, a turning robot smears its sweeps."
        yield Finding("TOP-102", "warning", topic.name, message)


def topic_findings(inspected: Sequence[Inspected]) -> Iterator[Finding]:
    """Roles that nobody fills, and roles that several topics fit."""
    names: dict[Role, list[str]] = {}
    for topic, role, _timing in inspected:
        if topic.count:
            names.setdefault(role, []).append(topic.name)
    if "lidar" not in names:
        packets = [topic.name for topic, _role, _timing in inspected if topic.type in PACKET_TYPES]
        why = f"{packets[0]} holds raw packets: let the driver publish points." if packets else "Labels need one."
        yield Finding("TOP-101", "error", packets[0] if packets else "", f"No LiDAR PointCloud2 found. {why}")
    if not names.keys() & set(POSE_ROLES):
        message = "No source of poses: neither INS, odometry nor /tf. Labels need one."
        yield Finding("TOP-103", "warning", "", message)
    for role in SINGLE_ROLES:
        if len(listed := names.get(role, [])) > 1:
            message = f"{len(listed)} topics fit role {role}: {', '.join(listed)}; choose one."
            yield Finding("TOP-110", "warning", listed[0], message)
