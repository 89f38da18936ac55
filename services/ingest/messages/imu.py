"""sensor_msgs/msg/Imu: angular velocity and linear acceleration.

**Conventions.** Samples are in the order of the messages. The orientation is not given: drivers fill it while they say
that they do not (covariance −1), and the other way round. Source: sensor_msgs (Humble), REP 145.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from services.ingest.cdr import HEADER, Field, groups
from services.ingest.messages.batch import Stamped, payloads_of

TYPE = "sensor_msgs/msg/Imu"
FIELDS: tuple[Field, ...] = (
    *HEADER,
    ("orientation", "4f8"),
    ("orientation_covariance", "9f8"),
    ("angular_velocity", "3f8"),
    ("angular_velocity_covariance", "9f8"),
    ("linear_acceleration", "3f8"),
    ("linear_acceleration_covariance", "9f8"),
)


@dataclass(frozen=True, eq=False)
class ImuSamples:
    """N readings in the sensor's own axes; `angular_velocity_rad_s` and `linear_acceleration_m_s2` are (N, 3)."""

    stamps_ns: NDArray[np.int64]
    angular_velocity_rad_s: NDArray[np.float64]
    linear_acceleration_m_s2: NDArray[np.float64]


def decode_imu(messages: Iterable[Stamped]) -> ImuSamples:
    """Raises: MessageLayoutError, ByteOrderError."""
    payloads = payloads_of(messages)
    stamps_ns = np.empty(len(payloads), np.int64)
    rates, accelerations = np.empty((len(payloads), 3)), np.empty((len(payloads), 3))
    for group in groups(payloads, lambda _payload: FIELDS, TYPE):
        stamps_ns[group.rows] = group.stamps_ns()
        rates[group.rows] = group.table["angular_velocity"]
        accelerations[group.rows] = group.table["linear_acceleration"]
    return ImuSamples(stamps_ns, rates, accelerations)
