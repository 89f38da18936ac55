"""The two versions of novatel_oem7_msgs, and which of them wrote a message.

**Conventions.** Humble is the driver's branch for ROS 2; older is its ROS 1 line, whose recordings are met converted:
`Oem7Header` lacks receiver_status and idle_time, station ids are strings. A recording that embeds its definitions
needs no choice. Without, versions are told apart by length and, where lengths agree, by values: a wrong layout lands
far outside of what the receiver documents. Source: novatel_oem7_driver, branches humble and master.
"""

from collections.abc import Iterable
from functools import cache
from typing import Any

import numpy as np

from stone_recordings.bags.errors import MessageLayoutError
from stone_recordings.messages.batch import StampedMessage
from stone_recordings.messages.types.columns import MessageTable
from stone_recordings.messages.types.definition import Field
from stone_recordings.messages.types.registry import Registry, registry, resolved
from stone_recordings.messages.types.sketch import Sketch, sketched
from stone_recordings.messages.types.table import decode_table

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
    """What is known, with the fields of the driver's ROS 1 line."""
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
    """Every column of one topic of any novatel_oem7_msgs type, by the definition that its recording embeds if it does.

    Raises: DefinitionMissingError, DefinitionRefusedError, MessageLayoutError, ByteOrderError.
    """
    listed = list(messages)
    if schema:
        return decode_table(type_name, listed, resolved(type_name, schema).registry, only)
    return decode_table(type_name, listed, _version_of(type_name, listed), only)


def fits(type_name: str, payload: memoryview) -> bool:
    """Whether some version of the type ends where the message does."""
    return any(_fitted(payload, known, type_name) for known in (registry(), older()))


def _version_of(type_name: str, messages: list[StampedMessage]) -> Registry:
    """The version that ends where the first message does and makes sense of it, else the one that ends there."""
    if not messages:
        return registry()
    payload = messages[0].payload
    fitting = [(known, sketch) for known in (registry(), older()) if (sketch := _fitted(payload, known, type_name))]
    if not fitting:
        raise MessageLayoutError(type_name, f"{len(payload)} bytes fit no version of the type that is known")
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
