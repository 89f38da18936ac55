"""The LiDAR model of a packet, from its own bytes, and the topic to record instead of an unsupported one.

**Conventions.** A Velodyne packet has 1206 bytes, and its last names the product. A Hesai packet starts with its blocks
(Pandar40P) or with EE FF and the version of its protocol. Source: user manuals of VLP-16, VLP-32C, VLS-128 (Velodyne),
Pandar40P, OT128 (Hesai).
"""

from collections.abc import Mapping
from typing import Literal

from stone_recordings.messages.errors import LidarPacketError

LidarModel = Literal["VLP-16", "VLP-32C", "VLS-128", "Pandar40P", "OT128"]
BLOCK, HESAI_HEAD = b"\xff\xee", b"\xee\xff"
VELODYNE_BYTES, PANDAR40P_BYTES = 1206, (1262, 1266)
VELODYNE_PRODUCTS: Mapping[int, LidarModel] = {0x22: "VLP-16", 0x28: "VLP-32C", 0xA1: "VLS-128"}
OTHER_PRODUCTS: Mapping[int, str] = {0x21: "HDL-32E", 0x24: "VLP-16 Hi-Res", 0x31: "Velarray"}
OT128_HEAD = HESAI_HEAD + b"\x01\x04"
# Flags in an OT128's header for the optional parts of a packet.
SAFETY_FLAG, CONFIDENCE_FLAG = 0x04, 0x10
SAFETY_BYTES, OT128_TAIL_BYTES = 17, 26
OTHER_HESAI: Mapping[tuple[int, int], str] = {
    (3, 2): "QT128", (4, 1): "AT128", (4, 3): "AT128", (6, 1): "PandarXT", (64, 6): "Pandar64",
}  # fmt: skip
COMPRESSED_CLOUD = "point_cloud_interfaces/msg/CompressedPointCloud2"
LIVOX_TYPES = frozenset(
    f"{package}/msg/CustomMsg" for package in ("livox_ros_driver", "livox_ros_driver2", "livox_interfaces")
)


def model_of(packet: memoryview) -> LidarModel | None:
    """Return the model; None if the packet is not a data packet of a supported model."""
    if len(packet) == VELODYNE_BYTES and packet[:2] == BLOCK:
        return VELODYNE_PRODUCTS.get(packet[VELODYNE_BYTES - 1])
    if len(packet) in PANDAR40P_BYTES and packet[:2] == BLOCK:
        return "Pandar40P"
    is_ot128 = len(packet) >= 12 and packet[:4] == OT128_HEAD and (packet[6], packet[7]) == (128, 2)
    return "OT128" if is_ot128 and len(packet) >= ot128_bytes(packet[11]) else None


def layout_of(packet: memoryview) -> int:
    """Return the flags that determine the layout of an OT128's packets; 0 for other models."""
    return packet[11] if packet[:2] == HESAI_HEAD else 0


def ot128_bytes(flags: int) -> int:
    """Return the size up to the end of the time: header, two blocks of 128 lasers, checksum, safety, tail."""
    record = 4 if flags & CONFIDENCE_FLAG else 3
    return 12 + 2 * (2 + 128 * record) + 4 + (SAFETY_BYTES if flags & SAFETY_FLAG else 0) + OT128_TAIL_BYTES


def refused(packet: memoryview, type_name: str) -> LidarPacketError:
    """Return why a packet without a supported model is refused, with the name of its LiDAR if the bytes reveal it."""
    if len(packet) == VELODYNE_BYTES and packet[:2] == BLOCK:
        product = packet[VELODYNE_BYTES - 1]
        name = OTHER_PRODUCTS.get(product, f"of product 0x{product:02X}")
        return LidarPacketError(type_name, f"a Velodyne {name}", topic_instead("velodyne"))
    if packet[:2] == HESAI_HEAD and len(packet) >= 4:
        version = (packet[2], packet[3])
        name = OTHER_HESAI.get(version, f"of protocol {version[0]}.{version[1]}")
        return LidarPacketError(type_name, f"a Hesai {name}", topic_instead("hesai"))
    named = f"an unknown sensor ({len(packet)} bytes, first {bytes(packet[:4]).hex(' ') or 'none'})"
    return LidarPacketError(type_name, named, topic_instead(type_name))


def topic_instead(name: str) -> str:
    """Return the driver's topic with the same data as points; `name` is a maker's, or that of a message type."""
    words = name.lower()
    return next((instead for word, instead in INSTEAD if word in words), "record the PointCloud2 topic of the driver")


# By a word of a message type.
INSTEAD = (
    ("velodyne", "record /velodyne_points of velodyne_pointcloud"),
    ("hesai", "record /lidar_points of hesai_ros_driver (send_point_cloud_ros: true)"),
    ("pandar", "record /lidar_points of hesai_ros_driver (send_point_cloud_ros: true)"),
    ("ouster", "record /ouster/points of ouster_ros, or make it of the packets by its replay.launch"),
    ("rslidar", "record /rslidar_points of rslidar_sdk (send_point_cloud_ros: true), or make it of the packets by "
                "msg_source: 2"),
    ("robosense", "record /robosense_points of nebula_ros"),
    ("livox", "record /livox/lidar of livox_ros_driver2 with xfer_format 0 (PointCloud2) or 1 (CustomMsg)"),
    ("sensor_msgs/msg/laserscan", "it has one plane; labels need the PointCloud2 of a LiDAR with many"),
    ("multiecholaserscan", "it has one plane; labels need the PointCloud2 of a LiDAR with many"),
    ("sensor_msgs/msg/pointcloud", "convert it to PointCloud2 (point_cloud_converter) and record that"),
)  # fmt: skip
