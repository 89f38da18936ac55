"""Livox's own message of points (CustomMsg) as the records of a cloud.

**Conventions.** A point's time is `timebase` plus its offset, nanoseconds. If the time base is not near the header's
stamp (it is 0, or counts from the sensor's start), offsets count from the stamp. The length of the list of points is
used; `point_num`, which repeats it, and the tags are not. Points have 19 bytes and begin at multiples of four, so none
follow the last. Source: livox_ros_driver, livox_ros_driver2 (CustomMsg, CustomPoint).
"""

from collections.abc import Callable

import numpy as np

from stone_recordings.bags.errors import ByteOrderError, MessageLayoutError
from stone_recordings.messages.lidars.points import POINT
from stone_recordings.messages.point_times import NEAR_NS
from stone_recordings.messages.pointcloud2 import Cloud
from stone_recordings.messages.types.cdr import Cursor

CUSTOM_POINT = np.dtype(
    [
        ("offset_time", "<u4"), ("x", "<f4"), ("y", "<f4"), ("z", "<f4"),
        ("reflectivity", "u1"), ("tag", "u1"), ("line", "u1"),
    ]
)  # fmt: skip
STEP_BYTES = 20
_NUMBERED_BYTES = 4 + 1 + 3  # point_num, lidar_id, rsvd


def livox_cloud(payload: memoryview, type_name: str) -> Cloud:
    """Decode a message. Raises: MessageLayoutError, ByteOrderError."""
    cursor = Cursor(payload, type_name)
    stamp_ns, frame_id = cursor.stamp_ns(), cursor.text()
    timebase_ns, count = _to_points(cursor)
    start = cursor.take(_size_bytes(count), 4)
    cursor.end()
    records = np.ndarray((count,), CUSTOM_POINT, payload, start, (STEP_BYTES,))
    points = np.empty(count, POINT)
    for name, theirs in (("x", "x"), ("y", "y"), ("z", "z"), ("intensity", "reflectivity"), ("ring", "line")):
        points[name] = records[theirs]
    late_ns = timebase_ns - stamp_ns
    points["time_stamp"] = records["offset_time"]
    points["time_stamp"] += late_ns if abs(late_ns) <= NEAR_NS else 0
    return Cloud(stamp_ns, frame_id, points)


def livox_count(head: memoryview, type_name: str) -> int:
    """Return the declared number of points; 0 if the head cannot be read."""
    try:
        return _counted(head, type_name)[0]
    except (MessageLayoutError, ByteOrderError):
        return 0


def livox_problem(head: memoryview, type_name: str, size_bytes: Callable[[], int]) -> str:
    """Return why a message with this head cannot be decoded; "" if the head is valid."""
    try:
        count, at = _counted(head, type_name)
    except (MessageLayoutError, ByteOrderError) as error:
        return str(error)
    end, size = at + _size_bytes(count), size_bytes()
    if not end <= size <= end + 3:
        return str(MessageLayoutError(type_name, f"its {count} points end at byte {end}, the message has {size}"))
    return ""


def _counted(head: memoryview, type_name: str) -> tuple[int, int]:
    """Return the declared number of points, and their start."""
    cursor = Cursor(head, type_name)
    cursor.stamp_ns()
    cursor.text()
    return _to_points(cursor)[1], cursor.at


def _to_points(cursor: Cursor) -> tuple[int, int]:
    """Return the time base, and the number of points that follow."""
    start = cursor.take(8, 8)
    timebase_ns = int.from_bytes(cursor.payload[start : start + 8], "little")
    cursor.take(_NUMBERED_BYTES, 4)
    return timebase_ns, cursor.u32()


def _size_bytes(count: int) -> int:
    return count * STEP_BYTES - (STEP_BYTES - CUSTOM_POINT.itemsize) if count else 0
