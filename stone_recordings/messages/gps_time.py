"""GPS week and milliseconds → Unix nanoseconds (UTC).

**Conventions.** GPS time runs without leap seconds from 1980-01-06T00:00:00 UTC and was level with UTC then. The
offset of a stamp is the one that was valid at that GPS instant. Source: IS-GPS-200, IERS Bulletin C.
"""

from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

NS_PER_S = 1_000_000_000
GPS_EPOCH_UNIX_S = 315_964_800
SECONDS_PER_WEEK = 604_800

# First UTC day with so many leap seconds since 1980 (no further one is announced up to 2027).
_LEAPS = (
    (1981, 7, 1), (1982, 7, 1), (1983, 7, 1), (1985, 7, 1), (1988, 1, 1), (1990, 1, 1), (1991, 1, 1), (1992, 7, 1),
    (1993, 7, 1), (1994, 7, 1), (1996, 1, 1), (1997, 7, 1), (1999, 1, 1), (2006, 1, 1), (2009, 1, 1), (2012, 7, 1),
    (2015, 7, 1), (2017, 1, 1),
)  # fmt: skip
# The GPS second (in Unix seconds without leaps) at which each day begins: it already counts the new leap.
_LEAP_GPS_S = np.array(
    [int(datetime(*day, tzinfo=UTC).timestamp()) + number for number, day in enumerate(_LEAPS, start=1)], np.int64
)


def leap_seconds(gps_unix_s: NDArray[np.int64]) -> NDArray[np.int64]:
    """GPS − UTC at instants given as GPS seconds since the Unix epoch without leap seconds."""
    return np.searchsorted(_LEAP_GPS_S, gps_unix_s, side="right").astype(np.int64)


def unix_ns(week: NDArray[np.integer], milliseconds: NDArray[np.integer]) -> NDArray[np.int64]:
    """UTC Unix nanoseconds of GPS weeks (not modulo 1024) and milliseconds of the week."""
    whole_ms = milliseconds.astype(np.int64)
    gps_unix_s = GPS_EPOCH_UNIX_S + week.astype(np.int64) * SECONDS_PER_WEEK + whole_ms // 1000
    return (gps_unix_s - leap_seconds(gps_unix_s)) * NS_PER_S + (whole_ms % 1000) * 1_000_000
