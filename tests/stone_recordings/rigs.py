"""A robot on a known path past a known wall, recorded by the sensors of the rig: what synchronisation must give back.

**Conventions.** Truth is closed form: a circle at 4.8 m/s and 28 °/s with a rolling, pitching body. INS angles and
geodetic positions are made by scipy and pymap3d from the true pose, never by the code under test.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pymap3d
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from stone.geometry.se3 import SE3
from stone.sensors.calibration import Calibration, Mount
from tests.stone_recordings import writing

T0_NS = 1_760_000_000_000_000_000
PERIOD_NS = 100_000_000
ORIGIN = (37.4, 127.1, 80.0)
SPEED_M_S, YAW_RATE_RAD_S = 4.8, np.deg2rad(28)
WALL_Y_M = 8.0
GPS_EPOCH_S, LEAP_S, WEEK_S = 315_964_800, 18, 604_800
LIDAR_TOPIC, INS_TOPIC, ODOM_TOPIC = "/lidar_points", "/novatel/oem7/inspvax", "/odom"
LIDAR_FRAME = "hesai_lidar"


def placed(rotvec: Sequence[float], xyz: Sequence[float]) -> SE3:
    wxyz = np.roll(Rotation.from_rotvec(rotvec).as_quat(), 1)
    return SE3.from_parts(wxyz, np.array(xyz, float))


EGO_FROM_LIDAR = placed([0.0, 0.05, 0.3], [0.2, 0.0, 1.1])
LIDAR_FROM_INS = placed([0.02, 0.0, -0.4], [-1.0, 0.3, -0.6])
MOUNTS = (
    Mount("INS", "ins", LIDAR_FROM_INS, "gps"),
    Mount("CAM_FRONT", "camera", placed([0.0, 0.0, 0.1], [0.1, 0, 0]), "cam_front"),
    Mount("RADAR_LEFT", "radar", placed([0.0, 0.0, 1.5], [0.0, 0.4, 0]), "radar"),
    Mount("IMU", "imu", placed([0.0, 0.0, 0.0], [0.0, 0.0, -0.3]), "imu_link"),
)


def calibration(*mounts: Mount) -> Calibration:
    return Calibration("rig", EGO_FROM_LIDAR, mounts or MOUNTS)


def world_from_ego(stamps_ns: NDArray[np.int64]) -> SE3:
    """The true path in east, north, up around `ORIGIN`."""
    seconds = (np.asarray(stamps_ns) - T0_NS) * 1e-9
    yaw, radius_m = 0.4 + YAW_RATE_RAD_S * seconds, SPEED_M_S / YAW_RATE_RAD_S
    angles = np.stack([yaw, np.deg2rad(6) * np.sin(seconds), np.deg2rad(10) * np.cos(0.7 * seconds)], axis=-1)
    wxyz = np.roll(Rotation.from_euler("ZYX", angles).as_quat(), 1, axis=-1)
    place_m = [radius_m * np.sin(yaw), -radius_m * np.cos(yaw), 0.5 * np.sin(seconds)]
    return SE3.from_parts(wxyz, np.stack(place_m, axis=-1))


def ins_messages(stamps_ns: NDArray[np.int64], seed: int = 0, **facts: Any) -> list[writing.Recorded]:
    """INSPVAX at whole milliseconds, stamped by a host that is 3 ± 2 ms late; `facts` overwrite status or type."""
    world_from_ins = world_from_ego(stamps_ns) @ EGO_FROM_LIDAR @ LIDAR_FROM_INS
    place_m = world_from_ins.translation_m + np.array([0, facts.get("north_m", 0), 0])
    geodetic = np.stack(pymap3d.enu2geodetic(*place_m.T, *ORIGIN), axis=-1)
    angles = Rotation.from_quat(np.roll(world_from_ins.wxyz, -1, axis=-1)).as_euler("ZYX", degrees=True)
    generator = np.random.default_rng(seed)
    late_ns = generator.integers(1_000_000, 5_000_000, len(stamps_ns))
    return [
        _ins(int(stamp), int(stamp + late), place, angle, facts)
        for stamp, late, place, angle in zip(stamps_ns, late_ns, geodetic, angles, strict=True)
    ]


def _ins(
    stamp_ns: int, host_ns: int, place: NDArray[np.float64], angles: NDArray[np.float64], facts: Any
) -> writing.Recorded:
    message = writing.random_message("novatel_oem7_msgs/msg/INSPVAX", np.random.default_rng(stamp_ns % 997), True)
    gps_ms = stamp_ns // 1_000_000 + (LEAP_S - GPS_EPOCH_S) * 1000
    message.header = writing.header(host_ns, "gps")
    message.nov_header.message_name = "INSPVAX"
    message.nov_header.gps_week_number, message.nov_header.gps_week_milliseconds = divmod(gps_ms, WEEK_S * 1000)
    message.ins_status.status = np.uint32(facts.get("ins_status", 3))
    message.pos_type.type = np.uint32(facts.get("pos_type", 56))
    message.latitude, message.longitude, message.height = place
    message.azimuth, message.pitch, message.roll = 90.0 - angles[0], -angles[1], angles[2]
    stdev_m = facts.get("stdev_m", 0.012)
    message.latitude_stdev, message.longitude_stdev, message.height_stdev = stdev_m, stdev_m, stdev_m
    return writing.Recorded(INS_TOPIC, "novatel_oem7_msgs/msg/INSPVAX", host_ns, writing.serialised(message))


def wall_sweep(stamp_ns: int, count: int = 400) -> writing.Recorded:
    """A Hesai sweep of the wall y = 8 m (in the world), each point measured from where the LiDAR was at its time."""
    offset_ns = (np.arange(count) * (PERIOD_NS // count)).astype(np.int64)
    x_m, z_m = np.linspace(-20, 20, count), np.tile([0.0, 1.0, 2.0, 3.0], count // 4)
    wall = np.stack([x_m, np.full(count, WALL_Y_M), z_m], axis=-1)
    lidar_from_world = (world_from_ego(stamp_ns + offset_ns) @ EGO_FROM_LIDAR).inverse()
    points = np.zeros(count, writing.HESAI)
    points["x"], points["y"], points["z"] = (lidar_from_world @ wall).T
    points["timestamp"], points["ring"] = (stamp_ns + offset_ns) * 1e-9, np.arange(count) % 128
    payload = writing.cloud_payload(points, writing.CloudText(stamp_ns=stamp_ns, frame_id=LIDAR_FRAME))
    return writing.Recorded(LIDAR_TOPIC, "sensor_msgs/msg/PointCloud2", stamp_ns + PERIOD_NS, payload)


def plain_sweep(stamp_ns: int, count: int = 1200, **facts: Any) -> writing.Recorded:
    """A sweep without point times."""
    points = np.zeros(count, writing.KITTI)
    points["x"], points["z"] = np.linspace(2, 30, count), -1.0
    payload = writing.cloud_payload(points, writing.CloudText(stamp_ns=stamp_ns, frame_id=LIDAR_FRAME, **facts))
    return writing.Recorded(LIDAR_TOPIC, "sensor_msgs/msg/PointCloud2", stamp_ns + PERIOD_NS, payload)


def stamped(topic: str, type_name: str, stamp_ns: int, frame_id: str) -> writing.Recorded:
    """Any message with a header; the rest is random, but that a picture begins like one."""
    message = writing.random_message(type_name, np.random.default_rng(0), True)
    message.header = writing.header(stamp_ns, frame_id)
    if type_name == "sensor_msgs/msg/CompressedImage":
        message.data = np.frombuffer(b"\xff\xd8\xff\xe0\x00\x10JFIF\x00\xff\xd9", np.uint8)
    return writing.Recorded(topic, type_name, stamp_ns + 1_000_000, writing.serialised(message))


def odometry(
    stamp_ns: int, pose: SE3, child: str = "base_link", topic: str = ODOM_TOPIC, parent: str = "odom"
) -> writing.Recorded:
    message = writing.random_message("nav_msgs/msg/Odometry", np.random.default_rng(0), True)
    message.header, message.child_frame_id = writing.header(stamp_ns, parent), child
    message.pose.pose = _pose("geometry_msgs/msg/Pose", "geometry_msgs/msg/Point", ("position", "orientation"), pose)
    return writing.Recorded(topic, "nav_msgs/msg/Odometry", stamp_ns + 2_000_000, writing.serialised(message))


def transform(topic: str, stamp_ns: int, parent: str, child: str, pose: SE3) -> writing.Recorded:
    names = ("translation", "rotation")
    message = writing.made(
        "tf2_msgs/msg/TFMessage",
        transforms=[
            writing.made(
                "geometry_msgs/msg/TransformStamped",
                header=writing.header(stamp_ns, parent),
                child_frame_id=child,
                transform=_pose("geometry_msgs/msg/Transform", "geometry_msgs/msg/Vector3", names, pose),
            )
        ],
    )
    return writing.Recorded(topic, "tf2_msgs/msg/TFMessage", stamp_ns, writing.serialised(message))


def _pose(type_name: str, vector: str, names: tuple[str, str], pose: SE3) -> Any:
    w, x, y, z = pose.wxyz.tolist()
    point = writing.made(vector, **dict(zip("xyz", pose.translation_m.tolist(), strict=True)))
    return writing.made(
        type_name, **{names[0]: point, names[1]: writing.made("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)}
    )


def written(path: Path, *groups: Sequence[writing.Recorded]) -> Path:
    """All messages in log-time order, in one MCAP."""
    messages = sorted((message for group in groups for message in group), key=lambda message: message.log_time_ns)
    return writing.write_mcap(path, messages)
