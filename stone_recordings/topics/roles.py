"""Roles of topics, resolved by type, then fields and size, then rate; the name only breaks ties.

**Conventions.** A cloud is a radar's when it has no ring and measures cross section, or speed at fewer points than any
revolution has: a frequency-modulated LiDAR measures speed, too. A small cloud without any of these is a planar
scanner's, unless its name says that it is a radar's. Source: field layouts of the Hesai, Nebula, Velodyne, Ouster,
Aeva, SICK and ARS 548 drivers.
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
# Whose packets these are, a LiDAR's or a radar's, only the topic's name says.
PACKETS_OF_EITHER = NEBULA_PACKETS
PACKET_TYPES = frozenset(PACKET_READERS)
POSE_ROLES: tuple[Role, ...] = ("ins", "odometry", "tf", "pose", "gnss")
# Of a receiver's messages these tell positions of which, with an IMU's attitude, poses are made.
POSITIONS = "sensor_msgs/msg/NavSatFix"
INSPVAX = "novatel_oem7_msgs/msg/INSPVAX"
# A LiDAR turns 5 to 20 times a second, a planar scanner up to 100; what is slower is a map. An IMU that integrates well
# samples faster than any pose source; what is slower is a copy for people to look at.
# Goals and corrected positions are poses, too, but rare ones.
PLAUSIBLE_HZ: dict[Role, tuple[float, float]] = {"lidar": (3.0, 110.0), "imu": (50.0, 2000.0), "pose": (3.0, 2000.0)}
POINT_CLOUD, TRANSFORMS = "sensor_msgs/msg/PointCloud2", "tf2_msgs/msg/TFMessage"
CLOUD_TYPES = frozenset({POINT_CLOUD, COMPRESSED_CLOUD})
# Of one LiDAR's sweeps in several forms the first of these is read.
FORMS = (LIVOX_TYPES | {POINT_CLOUD}, {COMPRESSED_CLOUD}, PACKET_TYPES)
RING_FIELDS = frozenset({"ring", "channel", "laser_id", "line"})
CROSS_SECTION_FIELDS = frozenset({"rcs", "radar_cross_section"})
# What radars measure of every detection, and a frequency-modulated LiDAR of every point.
SPEED_FIELDS = frozenset(
    {"range_rate", "v", "v_r", "v_radial", "vrad", "vx", "doppler", "doppler_velocity", "velocity", "radial_speed"}
    | {"radial_velocity", "speed", "snr"}
)
# A 16-beam LiDAR returns tens of thousands of points a turn, an ARS 548 at most 800, an imaging radar a few thousand.
LEAST_LIDAR_POINTS = 1000
LEAST_LIDAR_POINTS_WITH_SPEED = 5000
# Static transforms are latched: whoever repeats them does so less often than any moving joint is reported.
LAST_STATIC_RATE_HZ = 1.0


@dataclass(frozen=True)
class TopicFacts:
    """What is known of a topic without reading it all; `point_fields` and `point_count` are of its first cloud.

    Of packets that are not decoded here there is no cloud, and so no point. `problem` is why no cloud can be read.
    """

    name: str
    type: str
    rate_hz: float | None
    point_fields: frozenset[str] = frozenset()
    point_count: int = 0
    problem: str = ""


def role_of(facts: TopicFacts) -> Role:
    """The one role of a topic; "other" where nothing here uses it."""
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
    """Whether a topic of this name and type holds the packets of a radar."""
    return type_name == PACKETS_OF_EITHER and "radar" in name.lower()


def holds_sweeps(name: str, type_name: str) -> bool:
    """Whether a topic of this name and type may hold the sweeps of a LiDAR, as points or as packets."""
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
    """What tells two topics of one role apart."""

    @property
    def type(self) -> str: ...
    @property
    def count(self) -> int: ...
    @property
    def rate_hz(self) -> float | None: ...


class CloudRating(TopicRating, Protocol):
    """What tells two LiDAR topics apart."""

    @property
    def point_count(self) -> int: ...


Topical = TypeVar("Topical", bound=TopicRating)
Clouded = TypeVar("Clouded", bound=CloudRating)


def with_plausible_rate(role: Role, topics: Sequence[Topical]) -> Sequence[Topical]:
    """Those whose rate is the role's; all of them where none is, or where the role has none."""
    low_hz, high_hz = PLAUSIBLE_HZ.get(role, (0.0, float("inf")))
    plausible = [topic for topic in topics if topic.rate_hz is not None and low_hz <= topic.rate_hz <= high_hz]
    return plausible or topics


def likely_lidars(topics: Sequence[Clouded]) -> Sequence[Clouded]:
    """Of LiDAR topics those at a plausible rate; a cloud of few points, such as of obstacles, only without another.

    Compressed points only without others, packets only without points: whoever publishes both means the same sweeps.
    """
    forms = ([topic for topic in topics if topic.type in form] for form in FORMS)
    points = next((found for found in forms if found), topics)
    plausible = with_plausible_rate("lidar", points)
    return [topic for topic in plausible if topic.point_count >= LEAST_LIDAR_POINTS] or plausible


def fullest(topics: Sequence[Topical]) -> Sequence[Topical]:
    """INSPVA and INSPVAX of one receiver are the same solution: the more frequent, else the one with its quality."""
    if len({topic.type for topic in topics}) < len(topics):
        return topics
    return sorted(topics, key=lambda topic: (-topic.count, topic.type != INSPVAX))[:1]


def of_pose_role(role: Role, topics: Sequence[Topical]) -> Sequence[Topical]:
    """Of the topics of a role those that poses are taken of."""
    if role == "ins":
        return fullest(topics)
    if role == "gnss":
        return [topic for topic in topics if topic.type == POSITIONS]
    return with_plausible_rate(role, topics)
