"""Every decoder of messages, in an order that found cases rely on: new ones are added at the end."""

from collections.abc import Callable, Sequence
from functools import partial

from services.ingest.messages.batch import Stamped
from services.ingest.messages.camera import picture_of
from services.ingest.messages.camera_info import decode_camera_info
from services.ingest.messages.gnss import NAVSATFIX, decode_gnss
from services.ingest.messages.imu import decode_imu
from services.ingest.messages.novatel import decode_bestpos, decode_inspva
from services.ingest.messages.novatel_types import decode_novatel
from services.ingest.messages.odometry import decode_odometry
from services.ingest.messages.pointcloud2 import decode_cloud, lidar_points
from services.ingest.messages.radar import decode_radar
from services.ingest.messages.table import decode_table
from services.ingest.messages.tf import decode_transforms

Decoder = Callable[[Sequence[Stamped]], object]


def _cloud(messages: Sequence[Stamped]) -> object:
    return lidar_points(decode_cloud(messages[0].payload))


def _picture(type_name: str, messages: Sequence[Stamped]) -> object:
    return picture_of(type_name, messages[0].payload, 320)


DECODERS: tuple[Decoder, ...] = (
    _cloud,
    decode_imu,
    decode_inspva,
    decode_bestpos,
    decode_odometry,
    decode_transforms,
    partial(_picture, "sensor_msgs/msg/CompressedImage"),
    partial(_picture, "sensor_msgs/msg/Image"),
    decode_camera_info,
    partial(decode_gnss, NAVSATFIX),
    partial(decode_gnss, "gps_msgs/msg/GPSFix"),
    partial(decode_radar, "ars548_messages/msg/DetectionList"),
    partial(decode_radar, "continental_msgs/msg/ContinentalArs548DetectionList"),
    partial(decode_radar, "nebula_msgs/msg/NebulaPackets"),
    partial(decode_radar, "radar_msgs/msg/RadarScan"),
    partial(decode_radar, "sensor_msgs/msg/PointCloud2"),
    partial(decode_novatel, "novatel_oem7_msgs/msg/RXSTATUS"),
    partial(decode_table, "diagnostic_msgs/msg/DiagnosticArray"),
)
