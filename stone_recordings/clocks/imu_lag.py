"""The lag of the IMU against the pose source, from the messages that the scan kept of both.

**Conventions.** Orientations are the INS's where there is one, at GPS time, else those of odometry at its stamps; the
gyro's times are its header stamps. The IMU with the most messages is taken. Source: design §3.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from stone.sensors.gyro_lag import gyro_lag
from stone_recordings.bags.topic import Topic
from stone_recordings.clocks.report import ImuLag
from stone_recordings.messages.batch import StampedMessage
from stone_recordings.messages.imu import decode_imu
from stone_recordings.messages.novatel import decode_inspva
from stone_recordings.messages.odometry import decode_odometry
from stone_recordings.poses.ins_poses import enu_from_body_wxyz
from stone_recordings.report.scan import Scan
from stone_recordings.topics.roles import Role

IMU_BYTES = 512  # an Imu takes 324 bytes and its frame_id
POSE_BYTES = 1536  # an Odometry takes 720 bytes and two names
LAST_ANGLE_DEG = 720.0
# Below this the two hardly tell of the same turns, and the lag is noise.
LEAST_CORRELATION = 0.8
LAST_SIGMA_NS = 5_000_000

Oriented = tuple[NDArray[np.int64], NDArray[np.float64]]


def imu_lag(scan: Scan, topics: Sequence[tuple[Topic, Role]]) -> ImuLag | None:
    """None without an IMU or a pose source, and where the robot turned too little to tell.

    Raises: MessageLayoutError, ByteOrderError, MixedFramesError, PoseValueError.
    """
    imu = _fullest(scan, topics, "imu")
    source = _fullest(scan, topics, "ins") or _fullest(scan, topics, "odometry")
    if imu is None or source is None:
        return None
    samples = decode_imu(scan.kept[imu.name])
    lag = gyro_lag((samples.stamps_ns, samples.angular_velocity_rad_s), _oriented(source, scan.kept[source.name]))
    if lag is None or lag.correlation < LEAST_CORRELATION or lag.sigma_ns > LAST_SIGMA_NS:
        return None
    return ImuLag(imu.name, source.name, lag.lag_ns, lag.sigma_ns, lag.correlation)


def _fullest(scan: Scan, topics: Sequence[tuple[Topic, Role]], wanted: Role) -> Topic | None:
    """Of the topics of this role that could be read, the one with the most messages."""
    fitting = [topic for topic, role in topics if role == wanted and scan.kept.get(topic.name)]
    return max(fitting, key=lambda topic: topic.count, default=None)


def _oriented(source: Topic, messages: Sequence[StampedMessage]) -> Oriented:
    """Stamps and `wxyz` of the source's body; an INS without GPS time is left out."""
    if not source.type.startswith("novatel_oem7_msgs/"):
        odometry = decode_odometry(messages)
        return odometry.stamps_ns, odometry.parent_from_child.wxyz
    ins = decode_inspva(messages)
    angles_deg = np.stack([ins.roll_deg, ins.pitch_deg, ins.azimuth_deg])
    is_told = (ins.gps_stamps_ns > 0) & (np.abs(angles_deg) <= LAST_ANGLE_DEG).all(axis=0)
    return ins.gps_stamps_ns[is_told], enu_from_body_wxyz(*angles_deg[:, is_told])
