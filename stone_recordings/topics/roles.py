"""Roles of topics, resolved by type, then fields and size, then rate; the name only breaks ties.

**Conventions.** A cloud is a radar's if it has no ring and measures cross section, or speed with fewer points than any
revolution has, because a frequency-modulated LiDAR also measures speed. A small cloud without these fields is a planar
scanner's, unless its name contains a radar's word. Source: field layouts of the Hesai, Nebula, Velodyne, Ouster, Aeva,
SICK and ARS 548 drivers.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol, TypeVar

from stone_recordings.messages.lidars.models import COMPRESSED_CLOUD, LIVOX_TYPES
from stone_recordings.messages.lidars.packet_scan import NEBULA_PACKETS, PACKET_READERS

Role = Literal[
    "lidar", "camera", "radar", "gnss", "ins", "imu", "odometry", "pose", "tf", "tf_static", "camera_info", "other"
]

ROLE_OF_TYPE: dict[str, Role] = {
    "sensor_msgs/msg/Image": "camera",
    "sensor_msgs/msg/CompressedImage": "camera",
    "sensor_msgs/msg/CameraInfo": "camera_info",
    "sensor_msgs/msg/Imu": "imu",
    "sensor_msgs/msg/NavSatFix": "gnss",
    "gps_msgs/msg/GPSFix": "gnss",
    "gps_common/msg/GPSFix": "gnss",
    "novatel_oem7_msgs/msg/BESTPOS": "gnss",
    "novatel_oem7_msgs/msg/INSPVA": "ins",
    "novatel_oem7_msgs/msg/INSPVAX": "ins",
    "nav_msgs/msg/Odometry": "odometry",
    "geometry_msgs/msg/PoseStamped": "pose",
    "geometry_msgs/msg/PoseWithCovarianceStamped": "pose",
    "ars548_messages/msg/DetectionList": "radar",
    "continental_msgs/msg/ContinentalArs548DetectionList": "radar",
    "radar_msgs/msg/RadarScan": "radar",
}
# Packets of a LiDAR and of a radar have this same type; only the topic's name distinguishes them.
PACKETS_OF_EITHER = NEBULA_PACKETS
PACKET_TYPES = frozenset(PACKET_READERS)
POSE_ROLES: tuple[Role, ...] = ("ins", "odometry", "tf", "pose", "gnss")
# The receiver's messages from whose positions, with an IMU's attitude, poses are computed.
POSITIONS = "sensor_msgs/msg/NavSatFix"
INSPVAX = "novatel_oem7_msgs/msg/INSPVAX"
# A LiDAR turns 5 to 20 times a second, a planar scanner up to 100; a slower topic is a map. An IMU for integration
# samples faster than any pose source; a slower topic is a copy for display. Goals and corrected positions are poses
# too, but rare.
PLAUSIBLE_HZ: dict[Role, tuple[float, float]] = {"lidar": (3.0, 110.0), "imu": (50.0, 2000.0), "pose": (3.0, 2000.0)}
POINT_CLOUD, TRANSFORMS = "sensor_msgs/msg/PointCloud2", "tf2_msgs/msg/TFMessage"
CLOUD_TYPES = frozenset({POINT_CLOUD, COMPRESSED_CLOUD})
# If a LiDAR's sweeps exist in several forms, the first form in this order is read.
FORMS = (LIVOX_TYPES | {POINT_CLOUD}, {COMPRESSED_CLOUD}, PACKET_TYPES)
RING_FIELDS = frozenset({"ring", "channel", "laser_id", "line"})
CROSS_SECTION_FIELDS = frozenset({"rcs", "radar_cross_section"})
# Fields that radars measure for every detection, and a frequency-modulated LiDAR for every point.
SPEED_FIELDS = frozenset(
    {"range_rate", "v", "v_r", "v_radial", "vrad", "vx", "doppler", "doppler_velocity", "velocity", "radial_speed"}
    | {"radial_velocity", "speed", "snr"}
)
# A 16-beam LiDAR returns tens of thousands of points a turn, an ARS 548 at most 800, an imaging radar a few thousand.
LEAST_LIDAR_POINTS = 1000
LEAST_LIDAR_POINTS_WITH_SPEED = 5000
# Static transforms are latched: a repeated one arrives less often than the joint of any moving part.
LAST_STATIC_RATE_HZ = 1.0


@dataclass(frozen=True)
class TopicFacts:
    """Facts about a topic from its first messages; `point_fields` and `point_count` are of its first cloud.

    Packets that are not decoded give no cloud and no points. `problem` is the reason why no cloud can be read.
    """

    name: str
    type: str
    rate_hz: float | None
    point_fields: frozenset[str] = frozenset()
    point_count: int = 0
    problem: str = ""


def role_of(facts: TopicFacts) -> Role:
    """Return the one role of a topic; "other" if the platform does not use it."""
    if facts.type in CLOUD_TYPES:
        return "other" if facts.problem else _role_of_cloud(facts)
    if facts.type == TRANSFORMS:
        is_slow = facts.rate_hz is None or facts.rate_hz < LAST_STATIC_RATE_HZ
        return "tf_static" if is_slow and facts.name.rstrip("/").endswith("static") else "tf"
    if holds_radar_packets(facts.name, facts.type):
        return "radar"
    if facts.type in LIVOX_TYPES:
        return "other" if facts.problem else "lidar"
    if facts.type in PACKET_TYPES:
        return "lidar" if facts.point_count else "other"
    return ROLE_OF_TYPE.get(facts.type, "other")


def holds_radar_packets(name: str, type_name: str) -> bool:
    """Return whether a topic of this name and type holds the packets of a radar."""
    return type_name == PACKETS_OF_EITHER and "radar" in name.lower()


def holds_sweeps(name: str, type_name: str) -> bool:
    """Return whether a topic of this name and type may hold the sweeps of a LiDAR, as points or as packets."""
    is_points = type_name in CLOUD_TYPES or type_name in LIVOX_TYPES
    return is_points or (type_name in PACKET_TYPES and not holds_radar_packets(name, type_name))


def _role_of_cloud(facts: TopicFacts) -> Role:
    names = frozenset(name.lower() for name in facts.point_fields)
    if names & RING_FIELDS:
        return "lidar"
    if names & CROSS_SECTION_FIELDS:
        return "radar"
    if names & SPEED_FIELDS:
        return "lidar" if facts.point_count >= LEAST_LIDAR_POINTS_WITH_SPEED else "radar"
    if facts.point_count >= LEAST_LIDAR_POINTS:
        return "lidar"
    return "radar" if "radar" in facts.name.lower() else "lidar"


class TopicRating(Protocol):
    """Attributes that distinguish two topics of one role."""

    @property
    def type(self) -> str: ...
    @property
    def count(self) -> int: ...
    @property
    def rate_hz(self) -> float | None: ...


class CloudRating(TopicRating, Protocol):
    """Attributes that distinguish two LiDAR topics."""

    @property
    def point_count(self) -> int: ...


Topical = TypeVar("Topical", bound=TopicRating)
Clouded = TypeVar("Clouded", bound=CloudRating)


def with_plausible_rate(role: Role, topics: Sequence[Topical]) -> Sequence[Topical]:
    """Return the topics whose rate suits the role; all topics if none does or the role has no rate."""
    low_hz, high_hz = PLAUSIBLE_HZ.get(role, (0.0, float("inf")))
    plausible = [topic for topic in topics if topic.rate_hz is not None and low_hz <= topic.rate_hz <= high_hz]
    return plausible or topics


def likely_lidars(topics: Sequence[Clouded]) -> Sequence[Clouded]:
    """Return the LiDAR topics at a plausible rate; small clouds, such as obstacles, only if there is no other.

    Compressed points count only without plain points, packets only without points: a driver that publishes both forms
    publishes the same sweeps.
    """
    forms = ([topic for topic in topics if topic.type in form] for form in FORMS)
    points = next((group for group in forms if group), topics)
    plausible = with_plausible_rate("lidar", points)
    return [topic for topic in plausible if topic.point_count >= LEAST_LIDAR_POINTS] or plausible


def fullest(topics: Sequence[Topical]) -> Sequence[Topical]:
    """Return the topics with most messages; INSPVA and INSPVAX of one receiver are the same solution.

    The more frequent one is chosen, else the one with the quality.
    """
    if len({topic.type for topic in topics}) < len(topics):
        return topics
    return sorted(topics, key=lambda topic: (-topic.count, topic.type != INSPVAX))[:1]


def of_pose_role(role: Role, topics: Sequence[Topical]) -> Sequence[Topical]:
    """Return the topics of a role from which poses are taken."""
    if role == "ins":
        return fullest(topics)
    if role == "gnss":
        return [topic for topic in topics if topic.type == POSITIONS]
    return with_plausible_rate(role, topics)
