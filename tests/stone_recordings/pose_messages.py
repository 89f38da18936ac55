"""Messages that tell poses, or parts of them: PoseStamped, PoseWithCovarianceStamped, NavSatFix, Imu."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from stone.geometry.se3 import SE3
from tests.stone_recordings.writing import Recorded, header, made, serialised

POSED, WITH_COVARIANCE = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped"


def pose_message(stamp_ns: int, pose: SE3, type_name: str, topic: str, parent: str) -> Recorded:
    w, x, y, z = pose.wxyz.tolist()
    point = made("geometry_msgs/msg/Point", **dict(zip("xyz", pose.translation_m.tolist(), strict=True)))
    value = made(
        "geometry_msgs/msg/Pose", position=point, orientation=made("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)
    )
    if type_name == WITH_COVARIANCE:
        value = made("geometry_msgs/msg/PoseWithCovariance", pose=value, covariance=np.zeros(36))
    message = made(type_name, header=header(stamp_ns, parent), pose=value)
    return Recorded(topic, type_name, stamp_ns + 2_000_000, serialised(message))


def fix_message(stamp_ns: int, place: Any, status: int, frame_id: str, facts: Mapping[str, float]) -> Recorded:
    fields = dict(zip(("latitude", "longitude", "altitude"), place.tolist(), strict=True)) | facts
    message = made(
        "sensor_msgs/msg/NavSatFix",
        header=header(stamp_ns, frame_id),
        status=made("sensor_msgs/msg/NavSatStatus", status=status, service=1),
        position_covariance=np.zeros(9),
        position_covariance_type=0,
        **fields,
    )
    return Recorded("/fix", "sensor_msgs/msg/NavSatFix", stamp_ns + 3_000_000, serialised(message))


def attitude_message(stamp_ns: int, wxyz: Any, first_covariance: float, topic: str) -> Recorded:
    """Of the frame imu_link; it neither turns nor falls."""
    w, x, y, z = wxyz.tolist()
    zero = made("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
    message = made(
        "sensor_msgs/msg/Imu",
        header=header(stamp_ns, "imu_link"),
        orientation=made("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w),
        orientation_covariance=np.array([first_covariance, *np.zeros(8)]),
        angular_velocity=zero,
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration=zero,
        linear_acceleration_covariance=np.zeros(9),
    )
    return Recorded(topic, "sensor_msgs/msg/Imu", stamp_ns + 1_000_000, serialised(message))
