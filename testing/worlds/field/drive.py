"""A drive of four seconds over rolling ground, and its messages, which a test case replaces in part.

**Conventions.** Times `t` are seconds after the drive's start. The map is east, north, up; the LiDAR is mounted
`LIDAR_UP_M` above the robot's base and not turned. Messages are serialised by `rosbags`. The ground is analytic:
rolling hills, two round steps of 1.2 and 1.5 m. The robot moves during a sweep, so points need their times.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

Array = NDArray[np.float64]
Points = NDArray[Any]
BEGIN_S, SWEEPS, RINGS, COLUMNS, SWEEP_S = 1_700_000_000.0, 40, 24, 360, 0.1
LIDAR_UP_M = 0.95
DELAY_S = 0.11  # from the stamp to the recorder
DATATYPES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
VELODYNE = np.dtype(
    [("x", "f4"), ("y", "f4"), ("z", "f4"), ("intensity", "f4"), ("ring", "u2"), ("time", "f4")]
)  # `time` is seconds after the stamp
HESAI = np.dtype(
    [("x", "f4"), ("y", "f4"), ("z", "f4"), ("intensity", "f4"), ("ring", "u2"), ("timestamp", "f8")]
)  # `timestamp` is a date in seconds


def ground_m(x: Array, y: Array) -> Array:
    """Return the height of the ground at points (N,) of the map, metres."""
    steps = 1.2 * (np.hypot(x - 9, y - 6) < 1.1) + 1.5 * (np.hypot(x - 3, y + 6) < 0.9)
    return np.asarray(0.35 * np.sin(0.35 * x) * np.cos(0.28 * y) + steps)


def pose(t: Array | float) -> tuple[Any, Any, Any, Any]:
    """Return x, y, z in metres and yaw in radians of the robot's base in the map at times (N,) or one."""
    x, y = 1.2 * np.asarray(t), 1.5 * np.sin(0.5 * np.asarray(t))
    return x, y, ground_m(x, y), np.arctan(0.625 * np.cos(0.5 * np.asarray(t)))


def yaw_rate_rad_s(t: float) -> float:
    """Return the yaw rate of the robot, positive to the left."""
    return float((pose(t + 0.01)[3] - pose(t)[3]) * 100)


def sweep(t: float) -> tuple[NDArray[np.float32], Array, NDArray[np.int64]]:
    """Return the returns (N, 3) in the LiDAR's frame, their seconds after `t` (N,), and their rings (N,)."""
    azimuth = np.repeat(np.arange(COLUMNS) * 2 * np.pi / COLUMNS, RINGS)
    ring = np.tile(np.arange(RINGS), COLUMNS)
    after_s = azimuth * SWEEP_S / (2 * np.pi)
    x, y, z, yaw = pose(t + after_s)
    away_m = 1.3 * 1.14**ring
    height_m = ground_m(x + away_m * np.cos(yaw + azimuth), y + away_m * np.sin(yaw + azimuth))
    places = [away_m * np.cos(azimuth), away_m * np.sin(azimuth), height_m - z - LIDAR_UP_M]
    return np.stack(places, axis=1).astype(np.float32), after_s, ring


@dataclass(frozen=True)
class BareMessage:
    """A message with given bytes of any content."""

    __msgtype__: str
    content: bytes


class FieldTopic(NamedTuple):
    """A topic: its messages start `lead_s` before the drive, end as long after it, and are `step_s` apart.

    A message that is None was not recorded.
    """

    name: str
    step_s: float
    lead_s: float
    message: Callable[[float], Any]


@dataclass(frozen=True)
class FieldDrive:
    """The messages of a drive with this number of sweeps; `begin_s` is the start of its stamps.

    `definitions` describe further types of messages.
    """

    begin_s: float = BEGIN_S
    definitions: tuple[tuple[str, str], ...] = ()
    sweeps: int = SWEEPS
    store: Typestore = field(
        init=False, repr=False, compare=False, default_factory=lambda: get_typestore(Stores.ROS2_HUMBLE)
    )

    def __post_init__(self) -> None:
        for name, text in self.definitions:
            self.store.register(get_types_from_msg(text, name))

    def of(self, name: str, *values: Any) -> Any:
        """Return a message of a type by its fields in order."""
        return self.store.types[name](*values)

    def header(self, t: float, frame_id: str) -> Any:
        stamp = self.of("builtin_interfaces/msg/Time", *divmod(round((self.begin_s + t) * 1e9), 10**9))
        return self.of("std_msgs/msg/Header", stamp, frame_id)

    def points(self, t: float, record: np.dtype[Any] = VELODYNE) -> tuple[Points, Array]:
        """Return the records (N,) of a sweep without their times, and the seconds after `t` (N,)."""
        places, after_s, ring = sweep(t)
        points = np.zeros(len(places), record)
        points["x"], points["y"], points["z"] = places.T
        for name, values in (("ring", ring), ("intensity", 30)):
            if name in (record.names or ()):
                points[name] = values
        return points, after_s

    def cloud(self, t: float, points: Points, frame_id: str = "lidar", **other: Any) -> Any:
        """Return a PointCloud2 of these records; `other` replaces its declared fields."""
        record = points.dtype
        fields = [
            self.of("sensor_msgs/msg/PointField", name, offset, DATATYPES[kind.str[1:]], 1)
            for name, (kind, offset, *_) in (record.fields or {}).items()
        ]
        declared = {
            "header": self.header(t, frame_id), "height": 1, "width": len(points), "fields": fields,
            "is_bigendian": False, "point_step": record.itemsize, "row_step": points.nbytes,
            "data": np.frombuffer(points.tobytes(), np.uint8), "is_dense": True,
        }  # fmt: skip
        return self.store.types["sensor_msgs/msg/PointCloud2"](**(declared | other))

    def velodyne(self, t: float, frame_id: str = "lidar", **other: Any) -> Any:
        """Return the cloud of a sweep whose points have seconds after the stamp."""
        points, after_s = self.points(t)
        points["time"] = after_s
        return self.cloud(t, points, frame_id, **other)

    def pose_message(self, t: float) -> Any:
        x, y, z, yaw = map(float, pose(t))
        turn = self.of("geometry_msgs/msg/Quaternion", 0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2)))
        return self.of("geometry_msgs/msg/Pose", self.of("geometry_msgs/msg/Point", x, y, z), turn)

    def odometry(self, t: float, frame_id: str = "odom", child: str = "base_link") -> Any:
        """Return the exact pose of the robot's base."""
        still = self.of("geometry_msgs/msg/Twist", *[self.vector(0.0, 0.0, 0.0)] * 2)
        return self.of(
            "nav_msgs/msg/Odometry",
            self.header(t, frame_id),
            child,
            self.of("geometry_msgs/msg/PoseWithCovariance", self.pose_message(t), np.zeros(36)),
            self.of("geometry_msgs/msg/TwistWithCovariance", still, np.zeros(36)),
        )

    def imu(self, t: float, frame_id: str = "base_link") -> Any:
        """Return the measurement of an IMU at the robot's base, including its orientation."""
        turn, none = self.pose_message(t).orientation, np.zeros(9)
        spin, force = self.vector(0.0, 0.0, yaw_rate_rad_s(t)), self.vector(0.0, 0.0, 9.81)
        return self.of("sensor_msgs/msg/Imu", self.header(t, frame_id), turn, none, spin, none, force, none)

    def fix(self, t: float, frame_id: str = "base_link") -> Any:
        """Return the position of the robot's base by its receiver."""
        x, y, z, _yaw = map(float, pose(t))
        status = self.of("sensor_msgs/msg/NavSatStatus", 0, 1)
        position = (49.0149 + y / 111_200, 8.3887 + x / 73_010, 312.6 + z)
        spread = np.diag([1e-4, 1e-4, 4e-4]).ravel()
        return self.of("sensor_msgs/msg/NavSatFix", self.header(t, frame_id), status, *position, spread, 3)

    def vector(self, x: float, y: float, z: float) -> Any:
        return self.of("geometry_msgs/msg/Vector3", x, y, z)

    def lidar_topic(self, name: str = "/points") -> FieldTopic:
        return FieldTopic(name, SWEEP_S, 0.0, self.velodyne)

    def odometry_topic(self, name: str = "/odom") -> FieldTopic:
        return FieldTopic(name, 0.02, 0.2, self.odometry)

    def write(self, folder: Path, *topics: FieldTopic, sensors: str = "{}") -> tuple[Path, Path]:
        """Write `run` and `run.yaml` into a folder: the recording and its calibration; return their paths.

        `sensors` is the calibration's value of that key. The recorder's clock is the date, for any stamps.
        """
        folder.mkdir(parents=True, exist_ok=True)
        run = folder / "run"
        with Writer(run, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            for topic in topics:
                times = np.arange(-topic.lead_s, self.sweeps * SWEEP_S + topic.lead_s - 1e-9, topic.step_s).tolist()
                recorded = [(t, message) for t in times if (message := topic.message(t)) is not None]
                kind = recorded[0][1].__msgtype__
                connection = writer.add_connection(topic.name, kind, typestore=self.store)
                for t, message in recorded:
                    is_bare = isinstance(message, BareMessage)
                    content = message.content if is_bare else self.store.serialize_cdr(message, kind)
                    writer.write(connection, round((BEGIN_S + t + DELAY_S) * 1e9), content)
        calibration = folder / "run.yaml"
        calibration.write_text(
            "stone_calibration: 1\nname: case\nfootprint: {length_m: 1.0, width_m: 0.8}\n"
            f"ego_from_lidar: {{translation_m: [0.0, 0.0, {LIDAR_UP_M}], rotation_wxyz: [1.0, 0.0, 0.0, 0.0]}}\n"
            f"sensors: {sensors}\n"
        )
        return run, calibration
