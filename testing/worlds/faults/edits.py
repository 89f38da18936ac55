"""Edits of single messages, as rosbags reads them: any stamped message, poses, or clouds.

**Conventions.** Lengths are metres in the pose source's fixed frame, x east and y north; times are nanoseconds. An
INSPVAX has a position on Earth and three angles instead of an Odometry's position and quaternion; edits support both.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from stone_recordings.messages.types.cdr import NS_PER_S
from stone_recordings.messages.types.registry import typestore
from testing.worlds.faults.fault import Edit

FAR_FUTURE_S = 2_000_000_000  # 2033: fits into 32 bits
METRES_A_DEGREE = 111_320.0
WEEKS_AHEAD = 400
ODOMETRY = "nav_msgs/msg/Odometry"
STORE = typestore()


def serialised(message: Any) -> bytes:
    """Return the CDR of a message; bytes stay unchanged."""
    if isinstance(message, bytes):
        return message
    return bytes(STORE.serialize_cdr(message, message.__msgtype__))


def missing(message: Any) -> None:
    """Drop the message."""


def doubled(message: Any) -> list[Any]:
    return [message, message]


def emptied(message: Any) -> bytes:
    return b""


def garbage(message: Any) -> bytes:
    """Replace its bytes by as many meaningless bytes."""
    noise = np.random.default_rng(7).integers(0, 256, len(serialised(message)), np.uint8)
    return bytes(noise)


def cut(share: float) -> Edit:
    """Keep the first part of its bytes."""
    return lambda message: serialised(message)[: int(len(serialised(message)) * share)]


def big_endian(message: Any) -> bytes:
    data = bytearray(serialised(message))
    data[1] = 0
    return bytes(data)


def stamped(seconds: int) -> Edit:
    """Set another stamp."""

    def edit(message: Any) -> Any:
        message.header.stamp.sec, message.header.stamp.nanosec = seconds, 0
        _tell_gps_time(message, seconds)
        return message

    return edit


def later(seconds: float) -> Edit:
    """Move its stamp by `seconds`."""

    def edit(message: Any) -> Any:
        stamp = message.header.stamp
        stamp_ns = stamp.sec * NS_PER_S + stamp.nanosec + round(seconds * NS_PER_S)
        stamp.sec, stamp.nanosec = divmod(stamp_ns, NS_PER_S)
        header = getattr(message, "nov_header", None)
        if header is not None:
            header.gps_week_milliseconds += round(seconds * 1000)
        return message

    return edit


def in_frame(frame_id: str, child: str | None = None) -> Edit:
    """Set other names of frames."""

    def edit(message: Any) -> Any:
        message.header.frame_id = frame_id
        if child is not None:
            message.child_frame_id = child
        return message

    return edit


def moved(east_m: float, north_m: float, up_m: float) -> Edit:
    """Move a pose."""

    def edit(message: Any) -> Any:
        if message.__msgtype__ == ODOMETRY:
            position = message.pose.pose.position
            position.x, position.y, position.z = position.x + east_m, position.y + north_m, position.z + up_m
        else:
            narrow = np.cos(np.deg2rad(message.latitude))
            message.longitude += east_m / (METRES_A_DEGREE * narrow)
            message.latitude += north_m / METRES_A_DEGREE
            message.height += up_m
        return message

    return edit


def placed(value: float) -> Edit:
    """Set a pose's three coordinates to this number."""

    def edit(message: Any) -> Any:
        if message.__msgtype__ == ODOMETRY:
            position = message.pose.pose.position
            position.x = position.y = position.z = value
        else:
            message.latitude = message.longitude = message.height = value
        return message

    return edit


def turned(xyzw: tuple[float, float, float, float]) -> Edit:
    """Set this quaternion; an INS has three angles, and as many of these become NaN as the quaternion has."""

    def edit(message: Any) -> Any:
        if message.__msgtype__ == ODOMETRY:
            turn = message.pose.pose.orientation
            turn.x, turn.y, turn.z, turn.w = xyzw
        else:
            message.roll, message.pitch, message.azimuth = xyzw[:3]
        return message

    return edit


def stretched(factor: float) -> Edit:
    """Scale the quaternion."""

    def edit(message: Any) -> Any:
        turn = message.pose.pose.orientation
        turn.x, turn.y, turn.z, turn.w = (factor * value for value in (turn.x, turn.y, turn.z, turn.w))
        return message

    return edit


def of_nothing(message: Any) -> Any:
    """Return all-zero odometry: a driver that publishes unset values, or wheels that stand."""
    position, turn = message.pose.pose.position, message.pose.pose.orientation
    position.x = position.y = position.z = turn.x = turn.y = turn.z = 0.0
    turn.w = 1.0
    return message


def standing(message: Any) -> Any:
    """Return the same pose for every message."""
    message.latitude, message.longitude, message.height = 49.0, 8.4, 110.0
    message.roll = message.pitch = message.azimuth = 0.0
    return message


def _tell_gps_time(message: Any, seconds: int) -> None:
    """If a receiver's message has its own time, set that one: it counts; week 0 is none."""
    header = getattr(message, "nov_header", None)
    if header is not None:
        header.gps_week_number = header.gps_week_number + WEEKS_AHEAD if seconds else 0


def points_of(message: Any) -> NDArray[np.float32]:
    """Return writable x, y, z (N, 3) of a cloud, its first three fields in every drive here."""
    message.data = message.data.copy()
    count = message.width * message.height
    steps = (message.point_step, 4)
    return np.ndarray((count, 3), "<f4", message.data.data, 0, steps)
