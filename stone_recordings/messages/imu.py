"""sensor_msgs/msg/Imu: angular velocity and linear acceleration.

**Conventions.** Samples are in the order of the messages. Only `decode_attitude` reads the orientation: some drivers
fill it although they mark it as not estimated (covariance −1), others leave it empty without that mark. It turns the
sensor's axes to east, north, up. Source: sensor_msgs (Humble), REP 103, REP 145.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone_recordings.messages.batch import MOST_COMPONENT, StampedMessage, are_turns
from stone_recordings.messages.problems import majority
from stone_recordings.messages.types.table import STAMP, decode_table

TYPE = "sensor_msgs/msg/Imu"
# The first element of the covariance of a quantity that is not estimated.
NOT_ESTIMATED = -1.0
_COLUMNS = (*STAMP, "angular_velocity", "linear_acceleration")


@dataclass(frozen=True, eq=False)
class ImuSamples:
    """N readings in the sensor's own axes; `angular_velocity_rad_s` and `linear_acceleration_m_s2` are (N, 3)."""

    stamps_ns: NDArray[np.int64]
    angular_velocity_rad_s: NDArray[np.float64]
    linear_acceleration_m_s2: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class AttitudeSamples:
    """N orientations `enu_from_imu_xyzw` (N, 4), as recorded; `is_told` (N,) marks those that the driver estimates.

    The covariance of an estimate does not start with −1, and its numbers are a rotation.
    """

    stamps_ns: NDArray[np.int64]
    frame_id: str
    enu_from_imu_xyzw: NDArray[np.float64]
    is_told: NDArray[np.bool_]


def decode_attitude(messages: Iterable[StampedMessage]) -> AttitudeSamples:
    """Decode the orientations. Raises: MessageLayoutError, ByteOrderError."""
    table = decode_table(TYPE, messages, only=(*STAMP, "header.frame_id", "orientation", "orientation_covariance"))
    xyzw = table.vectors("orientation", "xyzw")
    norm = np.linalg.norm(np.where(np.abs(xyzw) <= MOST_COMPONENT, xyzw, np.inf), axis=1)
    unknown = table.numbers("orientation_covariance", 9)[:, 0] == NOT_ESTIMATED
    is_told = ~unknown & np.isfinite(norm) & are_turns(norm)
    return AttitudeSamples(table.stamps_ns(), majority(table.texts("header.frame_id")), xyzw, is_told)


def decode_imu(messages: Iterable[StampedMessage]) -> ImuSamples:
    """Decode the readings. Raises: MessageLayoutError, ByteOrderError."""
    table = decode_table(TYPE, messages, only=_COLUMNS)
    return ImuSamples(table.stamps_ns(), table.vectors("angular_velocity"), table.vectors("linear_acceleration"))
