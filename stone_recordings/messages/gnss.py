"""sensor_msgs/NavSatFix and GPSFix: positions of any receiver.

**Conventions.** Degrees north and east; covariance is m², east, north, up. `height_m` is the driver's value: above the
ellipsoid for NavSatFix, above mean sea level for GPSFix (its own comment; NovAtel's driver follows both). Neither type
distinguishes an RTK-fixed solution from a differential one. Source: sensor_msgs (Humble), gps_msgs.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from stone_recordings.messages.batch import StampedMessage
from stone_recordings.messages.types.registry import resolved
from stone_recordings.messages.types.table import STAMP, MessageTable, decode_table

NAVSATFIX = "sensor_msgs/msg/NavSatFix"
GPSFIX_TYPES = frozenset({"gps_msgs/msg/GPSFix", "gps_common/msg/GPSFix"})
GNSS_TYPES = frozenset({NAVSATFIX, *GPSFIX_TYPES})
NO_FIX = -1
_COLUMNS = (*STAMP, "status.status", "latitude", "longitude", "altitude", "position_covariance",
            "position_covariance_type", "speed", "track", "climb")  # fmt: skip


@dataclass(frozen=True, eq=False)
class GnssSamples:
    """N positions; `status` is −1 without a fix; `covariance_type` 0 means that the covariance is unknown.

    `speed_m_s` over ground, `track_deg` clockwise from north and `climb_m_s` are None for NavSatFix.
    """

    stamps_ns: NDArray[np.int64]
    latitude_deg: NDArray[np.float64]
    longitude_deg: NDArray[np.float64]
    height_m: NDArray[np.float64]
    height_above: Literal["ellipsoid", "mean sea level"]
    status: NDArray[np.int16]
    covariance_enu_m2: NDArray[np.float64]
    covariance_type: NDArray[np.uint8]
    speed_m_s: NDArray[np.float64] | None
    track_deg: NDArray[np.float64] | None
    climb_m_s: NDArray[np.float64] | None

    @property
    def is_fixed(self) -> NDArray[np.bool_]:
        """Whether there is a finite position (N,)."""
        is_finite = np.isfinite(self.latitude_deg) & np.isfinite(self.longitude_deg) & np.isfinite(self.height_m)
        return np.asarray((self.status > NO_FIX) & is_finite)


def decode_gnss(type_name: str, messages: Iterable[StampedMessage], schema: str = "") -> GnssSamples:
    """Decode one topic of one of GNSS_TYPES. Raises: MessageLayoutError, ByteOrderError, DefinitionMissingError."""
    table = decode_table(type_name, messages, resolved(type_name, schema).registry, _COLUMNS)
    return GnssSamples(
        table.stamps_ns(),
        table.numbers("latitude"),
        table.numbers("longitude"),
        table.numbers("altitude"),
        "ellipsoid" if type_name == NAVSATFIX else "mean sea level",
        table.numbers("status.status", kinds="iu").astype(np.int16),
        table.numbers("position_covariance", 9).reshape(-1, 3, 3),
        table.numbers("position_covariance_type"),
        _optional(table, "speed"),
        _optional(table, "track"),
        _optional(table, "climb"),
    )


def _optional(table: MessageTable, name: str) -> NDArray[np.float64] | None:
    return table.numbers(name) if name in table.columns else None
