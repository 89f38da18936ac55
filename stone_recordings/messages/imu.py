"""sensor_msgs/msg/Imu: angular velocity and linear acceleration.

**Conventions.** Samples are in the order of the messages. The orientation is not given: drivers fill it while they say
that they do not (covariance −1), and the other way round. Source: sensor_msgs (Humble), REP 145.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone_recordings.messages.batch import StampedMessage
from stone_recordings.messages.types.table import STAMP, decode_table

TYPE = "sensor_msgs/msg/Imu"
_COLUMNS = (*STAMP, "angular_velocity", "linear_acceleration")


@dataclass(frozen=True, eq=False)
class ImuSamples:
    """N readings in the sensor's own axes; `angular_velocity_rad_s` and `linear_acceleration_m_s2` are (N, 3)."""

    stamps_ns: NDArray[np.int64]
    angular_velocity_rad_s: NDArray[np.float64]
    linear_acceleration_m_s2: NDArray[np.float64]


def decode_imu(messages: Iterable[StampedMessage]) -> ImuSamples:
    """Raises: MessageLayoutError, ByteOrderError."""
    table = decode_table(TYPE, messages, only=_COLUMNS)
    return ImuSamples(table.stamps_ns(), table.vectors("angular_velocity"), table.vectors("linear_acceleration"))
