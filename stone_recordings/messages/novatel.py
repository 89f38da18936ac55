"""NovAtel OEM7 INSPVA, INSPVAX and BESTPOS: what the receiver computed, at the time it computed it for.

**Conventions.** The header stamp is when the host published (`host_stamps_ns`); `gps_stamps_ns` is rebuilt from GPS
week and milliseconds and is 0 where the receiver knew no week. Angles are degrees as logged: azimuth clockwise from
north, roll right-handed about forward, pitch nose up. The driver's rule for ENU axes, x forward, is setRPY(roll,
−pitch, 90° − azimuth). Every other type of the package: `stone_recordings.messages.novatel_types`.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone_recordings.bags.errors import MessageLayoutError
from stone_recordings.messages.batch import StampedMessage
from stone_recordings.messages.gps_time import unix_ns
from stone_recordings.messages.novatel_types import PACKAGE, decode_novatel, fits
from stone_recordings.messages.types.columns import MessageTable, as_doubles

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
    """INSPVA or INSPVAX, one type at a time; `schema` is the definition that the recording embeds, "" for none.

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
    """Raises: MessageLayoutError, ByteOrderError."""
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
    """UTC (N,) of any type with a `nov_header`, from its GPS week and milliseconds; 0 where the week is unknown."""
    weeks = table.numbers("nov_header.gps_week_number", kinds="iu")
    return np.where(weeks > 0, unix_ns(weeks, table.numbers("nov_header.gps_week_milliseconds", kinds="iu")), 0)


def _ins_table(messages: list[StampedMessage], schema: str) -> MessageTable:
    """By the embedded definition, else as the type whose fields end where the messages do: no length is of both."""
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
