"""Edits of single messages, as rosbags reads them: of any stamped message, of poses, of clouds.

**Conventions.** Lengths are metres in the pose source's fixed frame, x east and y north; times are nanoseconds. An
INSPVAX has a place on Earth and three angles where an Odometry has a position and a quaternion; edits know both.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from stone_recordings.messages.types.cdr import NS_PER_S
from stone_recordings.messages.types.registry import typestore
from testing.worlds.faults.fault import Edit

FAR_FUTURE_S = 2_000_000_000  # 2033: what 32 bits still hold
METRES_A_DEGREE = 111_320.0
WEEKS_AHEAD = 400
ODOMETRY = "nav_msgs/msg/Odometry"
STORE = typestore()


def serialised(message: Any) -> bytes:
    """The CDR of a message; what is bytes already stays so."""
    if isinstance(message, bytes):
        return message
    return bytes(STORE.serialize_cdr(message, message.__msgtype__))


def missing(message: Any) -> None:
    """Not recorded."""


def doubled(message: Any) -> list[Any]:
    return [message, message]


def emptied(message: Any) -> bytes:
    return b""


def garbage(message: Any) -> bytes:
    """As many bytes as it had, of nothing."""
    noise = np.random.default_rng(7).integers(0, 256, len(serialised(message)), np.uint8)
    return bytes(noise)


def cut(share: float) -> Edit:
    """The first part of its bytes."""
    return lambda message: serialised(message)[: int(len(serialised(message)) * share)]


def big_endian(message: Any) -> bytes:
    data = bytearray(serialised(message))
    data[1] = 0
    return bytes(data)


def stamped(seconds: int) -> Edit:
    """With another stamp."""

    def edit(message: Any) -> Any:
        message.header.stamp.sec, message.header.stamp.nanosec = seconds, 0
        _tell_gps_time(message, seconds)
        return message

    return edit


def later(seconds: float) -> Edit:
    """Stamped later by so much."""

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
    """Under other names of frames."""

    def edit(message: Any) -> Any:
        message.header.frame_id = frame_id
        if child is not None:
            message.child_frame_id = child
        return message

    return edit


def moved(east_m: float, north_m: float, up_m: float) -> Edit:
    """A pose elsewhere."""

    def edit(message: Any) -> Any:
        if message.__msgtype__ == ODOMETRY:
            place = message.pose.pose.position
            place.x, place.y, place.z = place.x + east_m, place.y + north_m, place.z + up_m
        else:
            narrow = np.cos(np.deg2rad(message.latitude))
            message.longitude += east_m / (METRES_A_DEGREE * narrow)
            message.latitude += north_m / METRES_A_DEGREE
            message.height += up_m
        return message

    return edit


def placed(value: float) -> Edit:
    """A pose whose three coordinates are this number."""

    def edit(message: Any) -> Any:
        if message.__msgtype__ == ODOMETRY:
            place = message.pose.pose.position
            place.x = place.y = place.z = value
        else:
            message.latitude = message.longitude = message.height = value
        return message

    return edit


def turned(xyzw: tuple[float, float, float, float]) -> Edit:
    """With this quaternion; an INS has three angles, and as many of them are NaN as the quaternion has."""

    def edit(message: Any) -> Any:
        if message.__msgtype__ == ODOMETRY:
            turn = message.pose.pose.orientation
            turn.x, turn.y, turn.z, turn.w = xyzw
        else:
            message.roll, message.pitch, message.azimuth = xyzw[:3]
        return message

    return edit


def stretched(factor: float) -> Edit:
    """With a quaternion of another length."""

    def edit(message: Any) -> Any:
        turn = message.pose.pose.orientation
        turn.x, turn.y, turn.z, turn.w = (factor * value for value in (turn.x, turn.y, turn.z, turn.w))
        return message

    return edit


def of_nothing(message: Any) -> Any:
    """All-zero odometry: a driver that publishes what was never set, or wheels that are not turned."""
    place, turn = message.pose.pose.position, message.pose.pose.orientation
    place.x = place.y = place.z = turn.x = turn.y = turn.z = 0.0
    turn.w = 1.0
    return message


def standing(message: Any) -> Any:
    """The same pose in every message."""
    message.latitude, message.longitude, message.height = 49.0, 8.4, 110.0
    message.roll = message.pitch = message.azimuth = 0.0
    return message


def _tell_gps_time(message: Any, seconds: int) -> None:
    """Where a receiver's message has its own time, that is the one which counts; week 0 is none."""
    header = getattr(message, "nov_header", None)
    if header is not None:
        header.gps_week_number = header.gps_week_number + WEEKS_AHEAD if seconds else 0


def points_of(message: Any) -> NDArray[np.float32]:
    """x, y, z (N, 3) of a cloud, to be written to; they are its first three fields in every drive here."""
    message.data = message.data.copy()
    count = message.width * message.height
    steps = (message.point_step, 4)
    return np.ndarray((count, 3), "<f4", message.data.data, 0, steps)
