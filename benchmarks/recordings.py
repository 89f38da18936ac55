"""The recordings for measuring readers, written by the `mcap` library; payload data are noise.

**Conventions.** As in ROS 2 Humble's default recorder: chunks of 768 KiB, so a large cloud has a chunk of its own, and
no checksums. A recording is compressed only if its name contains the compression.
"""

from pathlib import Path
from typing import BinaryIO

import numpy as np
from mcap.writer import CompressionType, Writer

from simulator import ros_messages
from stone_recordings.messages.types.registry import message_definition, typestore

CLOUDS, POINTS, LISTS = 60, 230_400, 36_000
SCANNED_BYTES = 400_000_000
START_NS = 1_760_000_000_000_000_000
POINT = np.dtype(
    {
        "names": ["x", "y", "z", "intensity", "ring", "timestamp"],
        "formats": ["<f4", "<f4", "<f4", "<f4", "<u2", "<f8"],
        "offsets": [0, 4, 8, 12, 16, 24],
        "itemsize": 32,
    }
)
DATATYPES = {"<f4": 7, "<u2": 4, "<f8": 8}
COMPRESSIONS = {"none": CompressionType.NONE, "lz4": CompressionType.LZ4, "zstd": CompressionType.ZSTD}
CLOUD_TOPIC, LIST_TOPIC = "/lidar_points", "/radar/front/detections"


def write_clouds(path: Path, compression: str, clouds: int = CLOUDS) -> Path:
    """Write clouds of `POINTS` points of 32 bytes at 10 Hz, as noisy as a real sweep; return the path."""
    kind = "sensor_msgs/msg/PointCloud2"
    with path.open("wb") as file:
        writer, channel = _started(file, CLOUD_TOPIC, kind, compression)
        for number in range(clouds):
            stamp_ns = START_NS + number * 100_000_000
            writer.add_message(channel, stamp_ns, cloud_payload(number), stamp_ns)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def write_lists(path: Path, count: int = LISTS) -> Path:
    """Write detection lists of three radars' size, 300 of 800 slots filled; return the path."""
    layout = ros_messages.detection_list("radar_front")
    record = layout.records(1)
    draws = np.random.default_rng(7)
    for name in ("azimuth", "elevation", "range", "range_rate"):
        record["list_detections"][name] = draws.normal(size=800).astype(np.float32)
    record["list_numofdetections"] = 300
    with path.open("wb") as file:
        writer, channel = _started(file, LIST_TOPIC, "ars548_messages/msg/DetectionList", "none")
        for number in range(count):
            stamp_ns = START_NS + number * 16_666_667
            record["sec"], record["nanosec"] = divmod(stamp_ns, 1_000_000_000)
            writer.add_message(channel, stamp_ns, record.tobytes(), stamp_ns)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def _started(file: BinaryIO, topic: str, kind: str, compression: str) -> tuple[Writer, int]:
    writer = Writer(file, chunk_size=768 << 10, compression=COMPRESSIONS[compression], enable_crcs=False)
    writer.start("ros2", library="")
    schema = writer.register_schema(kind, "ros2msg", message_definition(kind).encode())
    return writer, writer.register_channel(topic, "cdr", schema)


def cloud_payload(number: int) -> bytes:
    """Return the message of one cloud, the same for the same number."""
    stamp_ns = START_NS + number * 100_000_000
    draws = np.random.default_rng(number)
    points = np.zeros(POINTS, POINT)
    for axis in "xyz":
        points[axis] = draws.normal(0, 20, POINTS).round(3)
    points["intensity"] = draws.integers(0, 255, POINTS)
    points["ring"] = np.tile(np.arange(128), POINTS // 128)
    points["timestamp"] = stamp_ns / 1e9 + np.repeat(np.arange(POINTS // 128), 128) * 1e-1 / (POINTS // 128)
    store = typestore()
    types = store.types
    fields = [
        types["sensor_msgs/msg/PointField"](name, offset, DATATYPES[POINT[name].str], 1)
        for name, (_, offset, *_) in (POINT.fields or {}).items()
    ]
    sec, nanosec = divmod(stamp_ns, 1_000_000_000)
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](sec, nanosec), "hesai_lidar")
    data = points.view(np.uint8).reshape(-1)
    message = types["sensor_msgs/msg/PointCloud2"](
        header, 1, POINTS, fields, False, POINT.itemsize, len(data), data, False
    )
    return bytes(store.serialize_cdr(message, "sensor_msgs/msg/PointCloud2"))
