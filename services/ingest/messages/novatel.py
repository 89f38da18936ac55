"""NovAtel OEM7 INSPVA, INSPVAX and BESTPOS: what the receiver computed, at the time it computed it for.

**Conventions.** The header stamp is when the host published (`host_stamps_ns`); `gps_stamps_ns` is rebuilt from GPS
week and milliseconds and is 0 where the receiver knew no week. Angles are degrees as logged: azimuth clockwise from
north, roll right-handed about forward, pitch nose up. The driver's rule for ENU axes, x forward, is setRPY(roll,
−pitch, 90° − azimuth). Two versions of `Oem7Header` exist (Humble adds receiver_status and idle_time), told apart by
length and, where lengths agree, by values. Source: novatel_oem7_driver, branches humble and master.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.ingest.cdr import HEADER, Field, fits, groups, layout
from services.ingest.errors import MessageLayoutError
from services.ingest.messages.batch import Stamped, payloads_of
from services.ingest.messages.gps_time import unix_ns

INS_SOLUTION_GOOD, INS_SOLUTION_FREE, INS_ALIGNMENT_COMPLETE = 3, 6, 7
NARROW_INT, INS_RTKFLOAT, INS_RTKFIXED = 50, 55, 56
# Largest values that the receiver documents; a wrong layout lands far outside.
LAST_SOL_STATUS, LAST_POS_TYPE = 22, 80

_OLD_HEADER: tuple[Field, ...] = (
    ("message_name", "string"), ("message_id", "u2"), ("message_type", "u1"), ("sequence_number", "u4"),
    ("time_status", "u1"), ("week", "u2"), ("milliseconds", "u4"),
)  # fmt: skip
_HUMBLE_HEADER: tuple[Field, ...] = (*_OLD_HEADER, ("receiver_status", "u4"), ("idle_time", "f4"))
_POSITION: tuple[Field, ...] = (("latitude", "f8"), ("longitude", "f8"), ("height", "f8"))
_MOTION: tuple[Field, ...] = (("velocity_neu", "3f8"), ("roll", "f8"), ("pitch", "f8"), ("azimuth", "f8"))
_INSPVA: tuple[Field, ...] = (*_POSITION, *_MOTION, ("ins_status", "u4"))
_INSPVAX: tuple[Field, ...] = (
    ("ins_status", "u4"), ("pos_type", "u4"), *_POSITION, ("undulation", "f4"), *_MOTION,
    ("position_stdev", "3f4"), ("velocity_stdev", "3f4"), ("attitude_stdev", "3f4"),
    ("extended_status", "u4"), ("time_since_update", "u2"),
)  # fmt: skip
_FIX: tuple[Field, ...] = (
    ("sol_status", "u4"), ("pos_type", "u4"), *_POSITION, ("undulation", "f4"), ("datum_id", "u4"),
    ("position_stdev", "3f4"),
)  # fmt: skip
_FIX_TAIL: tuple[Field, ...] = (("diff_age", "f4"), ("sol_age", "f4"), ("satellites", "4u1"), ("masks", "4u1"))

INS_LAYOUTS = tuple((*HEADER, *head, *body) for body in (_INSPVAX, _INSPVA) for head in (_HUMBLE_HEADER, _OLD_HEADER))
FIX_LAYOUTS = (
    (*HEADER, *_HUMBLE_HEADER, *_FIX, ("stn_id", "4i1"), *_FIX_TAIL),
    (*HEADER, *_OLD_HEADER, *_FIX, ("stn_id", "string"), *_FIX_TAIL),
)


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


def decode_inspva(messages: Iterable[Stamped]) -> InsSamples:
    """INSPVA or INSPVAX, one type at a time. Raises: MessageLayoutError, ByteOrderError."""
    columns, names = _columns(messages, INS_LAYOUTS, "novatel_oem7_msgs/msg/INSPVA(X)")
    has_quality = "pos_type" in names
    return InsSamples(
        columns["host_stamps_ns"],
        columns["gps_stamps_ns"],
        columns["latitude"],
        columns["longitude"],
        columns["height"],
        columns["velocity_neu"][:, [1, 0, 2]],
        columns["roll"],
        columns["pitch"],
        columns["azimuth"],
        columns["ins_status"],
        columns["pos_type"] if has_quality else None,
        columns["position_stdev"].astype(np.float64) if has_quality else None,
    )


def decode_bestpos(messages: Iterable[Stamped]) -> FixSamples:
    """Raises: MessageLayoutError, ByteOrderError."""
    columns, _names = _columns(messages, FIX_LAYOUTS, "novatel_oem7_msgs/msg/BESTPOS")
    return FixSamples(
        columns["host_stamps_ns"],
        columns["gps_stamps_ns"],
        columns["time_status"],
        columns["sol_status"],
        columns["pos_type"],
        columns["latitude"],
        columns["longitude"],
        columns["height"],
        columns["undulation"].astype(np.float64),
        columns["position_stdev"].astype(np.float64),
    )


def _columns(
    messages: Iterable[Stamped], layouts: Sequence[tuple[Field, ...]], type_name: str
) -> tuple[dict[str, NDArray[Any]], frozenset[str]]:
    """Every scalar field of every message, in order, with both stamps; and the names that the type has."""
    payloads = payloads_of(messages)
    parts = list(groups(payloads, lambda payload: _layout_of(payload, layouts, type_name), type_name))
    wanted = [frozenset(part.table.dtype.names or ()) & {"pos_type", "time_since_update"} for part in parts]
    if len(set(wanted)) > 1:
        raise MessageLayoutError(type_name, "INSPVA and INSPVAX messages are mixed in one topic")
    fields = layouts[0] if wanted and wanted[0] else layouts[-1]
    kinds = {name: kind for name, kind in fields if kind != "string" and name != "stn_id"}
    shared = {name: kind for name, kind in kinds.items() if name not in ("receiver_status", "idle_time")}
    columns: dict[str, NDArray[Any]] = {name: np.empty(len(payloads), np.dtype(kind)) for name, kind in shared.items()}
    columns["host_stamps_ns"] = np.empty(len(payloads), np.int64)
    for part in parts:
        columns["host_stamps_ns"][part.rows] = part.stamps_ns()
        for name in shared:
            columns[name][part.rows] = part.table[name]
    weeks, milliseconds = columns["week"], columns["milliseconds"]
    columns["gps_stamps_ns"] = np.where(weeks > 0, unix_ns(weeks, milliseconds), 0)
    return columns, frozenset(kinds)


def _layout_of(payload: memoryview, layouts: Sequence[tuple[Field, ...]], type_name: str) -> tuple[Field, ...]:
    """The first layout that ends where the payload does and makes sense of it, else the first that ends there."""
    fitting = [fields for fields in layouts if fits(payload, fields, type_name)]
    if not fitting:
        raise MessageLayoutError(type_name, f"{len(payload)} bytes fit no version of the type that is known")
    return next((fields for fields in fitting if _is_plausible(payload, fields, type_name)), fitting[0])


def _is_plausible(payload: memoryview, fields: tuple[Field, ...], type_name: str) -> bool:
    row = np.frombuffer(payload, layout(payload, fields, type_name))[0]
    names = row.dtype.names or ()
    limits = {"sol_status": LAST_SOL_STATUS, "pos_type": LAST_POS_TYPE, "latitude": 90.0, "longitude": 180.0}
    return all(name not in names or abs(float(row[name])) <= limit for name, limit in limits.items())
