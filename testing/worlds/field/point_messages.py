"""The sweeps of a field drive as other messages of points: Livox's own, and compressed clouds."""

import gzip
import zlib
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import zstandard

from testing.worlds.field.drive import SWEEP_S, FieldDrive, FieldTopic

LIVOX_POINT = (
    "uint32 offset_time\nfloat32 x\nfloat32 y\nfloat32 z\nuint8 reflectivity\nuint8 tag\nuint8 line\n"  # as published
)
LIVOX_MESSAGE = (
    "std_msgs/Header header\nuint64 timebase\nuint32 point_num\nuint8 lidar_id\nuint8[3] rsvd\n{package}/CustomPoint[] "
    "points\n"
)
COMPRESSED = "point_cloud_interfaces/msg/CompressedPointCloud2"
COMPRESSED_FIELDS = (
    "std_msgs/Header header\nuint32 height\nuint32 width\nsensor_msgs/PointField[] fields\nbool is_bigendian\n"
    "uint32 point_step\nuint32 row_step\nuint8[] compressed_data\nbool is_dense\nstring format\n"
)
MOST_POINTS = 1 << 20
PACKERS: Mapping[str, Callable[[bytes], bytes]] = {
    "zlib": gzip.compress,  # the plugin's stream has a gzip header
    "zlib with its own header": zlib.compress,
    "zstd": zstandard.compress,
    "draco": lambda content: b"DRACO" + content[:64],
}


def livox_definitions(package: str = "livox_ros_driver2") -> tuple[tuple[str, str], ...]:
    return (
        (f"{package}/msg/CustomPoint", LIVOX_POINT),
        (f"{package}/msg/CustomMsg", LIVOX_MESSAGE.format(package=package)),
    )


def livox_message(
    drive: FieldDrive, t: float, timebase_ns: int | None = None, package: str = "livox_ros_driver2", **other: Any
) -> Any:
    """Return the sweep at `t`; its time base is the stamp's if none is given; `other` replaces fields."""
    points, after_s = drive.points(t)
    point = drive.store.types[f"{package}/msg/CustomPoint"]
    rows = zip(after_s.tolist(), points["x"], points["y"], points["z"], points["ring"].tolist(), strict=True)
    listed = [point(round(s * 1e9), float(x), float(y), float(z), 30, 16, ring % 6) for s, x, y, z, ring in rows]
    stamp_ns = round((drive.begin_s + t) * 1e9)
    declared: dict[str, Any] = {
        "header": drive.header(t, "livox_frame"), "timebase": stamp_ns if timebase_ns is None else timebase_ns,
        "point_num": len(listed), "lidar_id": 192, "rsvd": np.zeros(3, np.uint8), "points": listed,
    }  # fmt: skip
    return drive.store.types[f"{package}/msg/CustomMsg"](**(declared | other))


def compressed_message(drive: FieldDrive, t: float, packer: str, most_points: int = MOST_POINTS) -> Any:
    """Return the sweep at `t`, or its first points, compressed by one of PACKERS."""
    points, after_s = drive.points(t)
    points["time"] = after_s
    cloud = drive.cloud(t, points[:most_points])
    data = np.frombuffer(PACKERS[packer](cloud.data.tobytes()), np.uint8)
    fields = {
        name: getattr(cloud, name)
        for name in ("header", "height", "width", "fields", "is_bigendian", "point_step", "row_step", "is_dense")
    }
    return drive.store.types[COMPRESSED](**fields, compressed_data=data, format=packer.split()[0])


def topic(name: str, message: Callable[[float], Any]) -> FieldTopic:
    """Return a topic of sweeps."""
    return FieldTopic(name, SWEEP_S, 0.0, message)
