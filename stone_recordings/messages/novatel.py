"""NovAtel OEM7 INSPVA, INSPVAX and BESTPOS: the receiver's solution, at its own time.

**Conventions.** The header stamp is the host's publish time (`host_stamps_ns`); `gps_stamps_ns` is rebuilt from GPS
week and milliseconds and is 0 if the receiver had no week. Angles are degrees as logged: azimuth clockwise from north,
roll right-handed about forward, pitch nose up. The driver's rule for ENU axes, x forward, is setRPY(roll, −pitch, 90° −
azimuth). Every other type of the package follows below.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stone_recordings.bags.errors import MessageLayoutError
from stone_recordings.messages.batch import StampedMessage
from stone_recordings.messages.types.definition import Field
from stone_recordings.messages.types.registry import Registry, registry, resolved
from stone_recordings.messages.types.sketch import Sketch, sketched
from stone_recordings.messages.types.table import MessageTable, as_doubles, decode_table

# The two versions of novatel_oem7_msgs, and how to detect the one that wrote a message. Humble is the driver's branch
# for ROS 2; older is its ROS 1 line, whose recordings occur converted: `Oem7Header` lacks receiver_status and
# idle_time, station ids are strings. A recording with embedded definitions needs no detection. Otherwise length and,
# for equal lengths, values decide: a wrong layout gives values far outside the receiver's documented ranges. Source:
# novatel_oem7_driver, branches humble and master.


PACKAGE = "novatel_oem7_msgs/msg/"
_ADDED_BY_HUMBLE = frozenset({"receiver_status", "idle_time"})
# Largest values that the receiver documents (OEM7 commands and logs reference, tables of BESTPOS and INSPVA).
LIMITS = {
    "sol_status.status": 22, "pos_type.type": 80, "vel_type.type": 80, "status.status": 14, "ins_status.status": 14,
    "latitude": 90, "longitude": 180, "lat": 90, "lon": 180, "heading": 360, "azimuth": 360, "trk_gnd": 360,
    "lon_zone_number": 60, "clock_status": 4,
}  # fmt: skip


@cache
def older() -> Registry:
    """Return the known types with the fields of the driver's ROS 1 line."""
    known = registry()
    types = {
        name: tuple(_older_field(field) for field in fields if field.name not in _ADDED_BY_HUMBLE)
        for name, fields in known.types.items()
        if name.startswith(PACKAGE)
    }
    return known.with_types(types)


def decode_novatel(
    type_name: str, messages: Iterable[StampedMessage], schema: str = "", only: tuple[str, ...] | None = None
) -> MessageTable:
    """Decode every column of one topic of a novatel_oem7_msgs type, by the embedded definition if there is one.

    Raises: DefinitionMissingError, DefinitionRefusedError, MessageLayoutError, ByteOrderError.
    """
    listed = list(messages)
    if schema:
        return decode_table(type_name, listed, resolved(type_name, schema).registry, only)
    return decode_table(type_name, listed, _version_of(type_name, listed), only)


def fits(type_name: str, payload: memoryview) -> bool:
    """Return whether some version of the type ends at the end of the message."""
    return any(_fitted(payload, known, type_name) for known in (registry(), older()))


def _version_of(type_name: str, messages: list[StampedMessage]) -> Registry:
    """Return the version that fits the first message and gives plausible values, else a version that fits it."""
    if not messages:
        return registry()
    payload = messages[0].payload
    fitting = [(known, sketch) for known in (registry(), older()) if (sketch := _fitted(payload, known, type_name))]
    if not fitting:
        raise MessageLayoutError(type_name, f"{len(payload)} bytes fit no known version of the type")
    return next((known for known, sketch in fitting if _is_plausible(payload, sketch)), fitting[0][0])


def _fitted(payload: memoryview, known: Registry, type_name: str) -> Sketch | None:
    try:
        return sketched(payload, known.plan(type_name), type_name)
    except MessageLayoutError:
        return None


def _is_plausible(payload: memoryview, sketch: Sketch) -> bool:
    checked = (piece for piece in sketch.pieces if piece.node.name in LIMITS)
    return all(
        abs(float(_value(payload, piece.offset, getattr(piece.node, "code", None)))) <= LIMITS[piece.node.name]
        for piece in checked
    )


def _value(payload: memoryview, offset: int, code: Any) -> Any:
    return np.frombuffer(payload, code, 1, offset)[0]


def _older_field(field: Field) -> Field:
    return Field(field.name, "string") if field.name.endswith("stn_id") else field


INS_SOLUTION_GOOD, INS_SOLUTION_FREE, INS_ALIGNMENT_COMPLETE = 3, 6, 7
NARROW_INT, INS_RTKFLOAT, INS_RTKFIXED = 50, 55, 56
INSPVA, INSPVAX, BESTPOS = (f"{PACKAGE}{name}" for name in ("INSPVA", "INSPVAX", "BESTPOS"))


@dataclass(frozen=True, eq=False)
class InsSamples:
    """N INS solutions; `height_m` is ellipsoidal, `velocity_enu_m_s` (N, 3) is east, north, up.

    `position_stdev_m` (N, 3) is along latitude, longitude and height; it and `pos_type` are None for INSPVA.
    """

    host_stamps_ns: NDArray[np.int64]
    gps_stamps_ns: NDArray[np.int64]
    latitude_deg: NDArray[np.float64]
    longitude_deg: NDArray[np.float64]
    height_m: NDArray[np.float64]
    velocity_enu_m_s: NDArray[np.float64]
    roll_deg: NDArray[np.float64]
    pitch_deg: NDArray[np.float64]
    azimuth_deg: NDArray[np.float64]
    ins_status: NDArray[np.uint32]
    pos_type: NDArray[np.uint32] | None
    position_stdev_m: NDArray[np.float64] | None


@dataclass(frozen=True, eq=False)
class FixSamples:
    """N position solutions; `height_msl_m` is above mean sea level, + `undulation_m` it is ellipsoidal.

    `position_stdev_m` (N, 3) is along latitude, longitude and height.
    """

    host_stamps_ns: NDArray[np.int64]
    gps_stamps_ns: NDArray[np.int64]
    time_status: NDArray[np.uint8]
    sol_status: NDArray[np.uint32]
    pos_type: NDArray[np.uint32]
    latitude_deg: NDArray[np.float64]
    longitude_deg: NDArray[np.float64]
    height_msl_m: NDArray[np.float64]
    undulation_m: NDArray[np.float64]
    position_stdev_m: NDArray[np.float64]


def decode_inspva(messages: Iterable[StampedMessage], schema: str = "") -> InsSamples:
    """Decode INSPVA or INSPVAX, one type at a time; `schema` is the embedded definition, "" for none.

    Raises: MessageLayoutError, ByteOrderError.
    """
    listed = list(messages)
    table = _ins_table(listed, schema)
    has_quality = "pos_type.type" in table.columns
    velocities = np.stack([table.numbers(f"{name}_velocity") for name in ("east", "north", "up")], axis=1)
    return InsSamples(
        table.stamps_ns(),
        gps_stamps_ns(table),
        table.numbers("latitude"),
        table.numbers("longitude"),
        table.numbers("height"),
        velocities,
        table.numbers("roll"),
        table.numbers("pitch"),
        table.numbers("azimuth"),
        table.numbers("ins_status.status" if has_quality else "status.status"),
        table.numbers("pos_type.type") if has_quality else None,
        _deviations(table, ("latitude", "longitude", "height")) if has_quality else None,
    )


def decode_bestpos(messages: Iterable[StampedMessage], schema: str = "") -> FixSamples:
    """Decode BESTPOS. Raises: MessageLayoutError, ByteOrderError."""
    table = decode_novatel(BESTPOS, messages, schema)
    return FixSamples(
        table.stamps_ns(),
        gps_stamps_ns(table),
        table.numbers("nov_header.time_status"),
        table.numbers("sol_status.status"),
        table.numbers("pos_type.type"),
        table.numbers("lat"),
        table.numbers("lon"),
        table.numbers("hgt"),
        as_doubles(table.numbers("undulation")),
        _deviations(table, ("lat", "lon", "hgt")),
    )


def gps_stamps_ns(table: MessageTable) -> NDArray[np.int64]:
    """Return UTC (N,) of any type with a `nov_header`, from its GPS week and milliseconds; 0 for an unknown week."""
    weeks = table.numbers("nov_header.gps_week_number", kinds="iu")
    return np.where(weeks > 0, unix_ns(weeks, table.numbers("nov_header.gps_week_milliseconds", kinds="iu")), 0)


def _ins_table(messages: list[StampedMessage], schema: str) -> MessageTable:
    """Decode by the embedded definition, else by the type that fits the messages' length, which differs between the
    two.
    """
    if schema:
        return decode_novatel(INSPVAX, messages, schema)
    of_each_length = {len(message.payload): message.payload for message in messages}
    kinds = {next((kind for kind in (INSPVAX, INSPVA) if fits(kind, it)), INSPVAX) for it in of_each_length.values()}
    if len(kinds) > 1:
        raise MessageLayoutError(
            "novatel_oem7_msgs/msg/INSPVA(X)", "INSPVA and INSPVAX messages are mixed in one topic"
        )
    return decode_novatel(next(iter(kinds), INSPVA), messages)


def _deviations(table: MessageTable, names: tuple[str, str, str]) -> NDArray[np.float64]:
    return as_doubles(np.stack([table.numbers(f"{name}_stdev") for name in names], axis=1))


# GPS week and milliseconds → Unix nanoseconds (UTC). GPS time runs without leap seconds from 1980-01-06T00:00:00 UTC
# and was level with UTC then. The offset of a stamp is the one valid at that GPS instant. Source: IS-GPS-200, IERS
# Bulletin C.


NS_PER_S = 1_000_000_000
GPS_EPOCH_UNIX_S = 315_964_800
SECONDS_PER_WEEK = 604_800

# First UTC day with each number of leap seconds since 1980 (no further one is announced up to 2027).
_LEAPS = (
    (1981, 7, 1), (1982, 7, 1), (1983, 7, 1), (1985, 7, 1), (1988, 1, 1), (1990, 1, 1), (1991, 1, 1), (1992, 7, 1),
    (1993, 7, 1), (1994, 7, 1), (1996, 1, 1), (1997, 7, 1), (1999, 1, 1), (2006, 1, 1), (2009, 1, 1), (2012, 7, 1),
    (2015, 7, 1), (2017, 1, 1),
)  # fmt: skip
# The GPS second (in Unix seconds without leaps) at which each day starts: it already counts the new leap.
_LEAP_GPS_S = np.array(
    [int(datetime(*day, tzinfo=UTC).timestamp()) + number for number, day in enumerate(_LEAPS, start=1)], np.int64
)


def leap_seconds(gps_unix_s: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return GPS − UTC at instants given as GPS seconds since the Unix epoch without leap seconds."""
    return np.searchsorted(_LEAP_GPS_S, gps_unix_s, side="right").astype(np.int64)


def unix_ns(week: NDArray[np.integer], milliseconds: NDArray[np.integer]) -> NDArray[np.int64]:
    """Return UTC Unix nanoseconds of GPS weeks (not modulo 1024) and milliseconds of the week."""
    whole_ms = milliseconds.astype(np.int64)
    gps_unix_s = GPS_EPOCH_UNIX_S + week.astype(np.int64) * SECONDS_PER_WEEK + whole_ms // 1000
    return (gps_unix_s - leap_seconds(gps_unix_s)) * NS_PER_S + (whole_ms % 1000) * 1_000_000
