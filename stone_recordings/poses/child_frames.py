"""Names of the frames whose poses a source tells: whether one is a sensor's, and not the robot's base.

**Conventions.** `body` is a robot's base, but in `camera_init` the IMU of FAST-LIO and its kin, which sits above the
ground. Source of the names: FAST_LIO, FAST-LIVO2, Point-LIO, A-LOAM and LeGO-LOAM, as they publish odometry.
"""

import re

from stone.findings import Finding
from stone_recordings.poses.extrinsics import plain

SLAM_PARENT = "camera_init"
IN_SLAM = {"body": "IMU", "aft_mapped": "IMU or LiDAR", "aft_pgo": "IMU or LiDAR"}
WORDS = {
    "IMU": {"imu", "gyro", "ahrs", "xsens", "vectornav", "microstrain"},
    "LiDAR": {"lidar", "laser", "velodyne", "ouster", "os", "hesai", "pandar", "livox", "rslidar", "robosense"},
    "camera": {"camera", "cam", "optical", "zed", "realsense"},
    "receiver": {"gps", "gnss", "ins", "novatel", "antenna"},
}


def sensor_named(parent: str, child: str) -> str:
    """What kind of sensor the child frame is by its name; "" where that tells none."""
    frame = plain(child).lower()
    if plain(parent) == SLAM_PARENT and frame in IN_SLAM:
        return IN_SLAM[frame]
    words = set(re.findall("[a-z]+", frame))
    return next((sensor for sensor, known in WORDS.items() if words & known), "")


def assumed_finding(parent: str, child: str) -> Finding:
    """CAL-405: the frame was taken for the ego frame, for nobody says where it is."""
    if not child:
        sentence = "its messages do not name the frame of their poses; they are taken as poses of the ego frame"
        return Finding("CAL-405", "warning", "", f"{sentence} (give it with --poses-frame FRAME)")
    sentence = f"neither the calibration nor tf_static knows its frame {child!r}; it is taken for the ego frame"
    if sensor := sensor_named(parent, child):
        sentence += (
            f", although by its name under {parent!r} it is the {sensor}'s, which is above the ground and may be "
            f"rotated: add the sensor with frame_id {child} and its extrinsics to the calibration, or name the topic "
            "of the base's poses"
        )
    return Finding("CAL-405", "warning", child, sentence)
