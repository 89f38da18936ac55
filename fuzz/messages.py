"""All message decoders in a stable order: add new ones at the end."""

from collections.abc import Callable, Sequence
from functools import partial

from stone_recordings.messages.batch import StampedMessage
from stone_recordings.messages.camera import picture_of
from stone_recordings.messages.camera_info import decode_camera_info
from stone_recordings.messages.gnss import NAVSATFIX, decode_gnss
from stone_recordings.messages.imu import decode_attitude, decode_imu
from stone_recordings.messages.novatel import decode_bestpos, decode_inspva, decode_novatel
from stone_recordings.messages.odometry import POSE_STAMPED, POSE_WITH_COVARIANCE, decode_odometry
from stone_recordings.messages.pointcloud2 import decode_cloud, lidar_points
from stone_recordings.messages.radars.radar import decode_radar
from stone_recordings.messages.tf import decode_transforms
from stone_recordings.messages.types.table import decode_table

Decoder = Callable[[Sequence[StampedMessage]], object]


def _cloud(messages: Sequence[StampedMessage]) -> object:
    return lidar_points(decode_cloud(messages[0].payload))


def _picture(type_name: str, messages: Sequence[StampedMessage]) -> object:
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
    decode_attitude,
    partial(decode_odometry, type_name=POSE_STAMPED),
    partial(decode_odometry, type_name=POSE_WITH_COVARIANCE),
)
