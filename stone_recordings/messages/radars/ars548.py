"""ars548_messages/msg/DetectionList: 800 slots; the first `list_numofdetections` count.

**Conventions.** Slots beyond the count are left over from earlier scans and never read: only the head, the count and
the valid detections of each message are touched, for speed. Header stamps are the host's by the driver's default;
`sensor_stamps_ns` is the radar's own clock. Source: ars548_ros (ROS 2), ARS 548 RDI interface.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from struct import Struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stone_recordings.bags.errors import MessageLayoutError
from stone_recordings.messages.batch import StampedMessage, payloads_of
from stone_recordings.messages.radars.detections import (
    INVALID_MASK,
    RadarDetections,
    detections,
    joined_ns,
    offsets_of,
)
from stone_recordings.messages.types.plan import Leaf, Node
from stone_recordings.messages.types.registry import resolved
from stone_recordings.messages.types.sketch import PayloadPiece, sketched

TYPE = "ars548_messages/msg/DetectionList"
PLACES, COUNT = "list_detections", "list_numofdetections"
# Columns of the table and the driver's names for them.
FIELDS = {
    "azimuth": "f_azimuthangle", "elevation": "f_elevationangle", "range": "f_range", "range_rate": "f_rangerate",
    "rcs": "s_rcs", "flags": "u_invalidflags",
}  # fmt: skip
STAMPS = ("header.stamp.sec", "header.stamp.nanosec", "timestamp_seconds", "timestamp_nanoseconds")
# The columns that must be whole numbers in the definition.
CODES = (
    {f"{PLACES}.{name}": "<f4" for name in FIELDS.values()}
    | {f"{PLACES}.s_rcs": "i1", f"{PLACES}.u_invalidflags": "u1", COUNT: "<u4"}
    | {name: "<i4" if name == STAMPS[0] else "<u4" for name in STAMPS}
)
# Encapsulation and length of the frame's name: with the size, all that the layout of a message depends on.
_KEY = Struct("<4s8xI")
# The number of messages per batch: their detections stay in the processor's cache until they are columns.
_BATCH = 32


@dataclass(frozen=True, eq=False)
class _Layout:
    """The offsets in every message of one size and one length of its frame's name."""

    stamps: np.dtype[np.void]
    count_at: int
    first_at: int
    places: int
    detection: np.dtype[np.void]


def decode_ars548(messages: Iterable[StampedMessage], schema: str = "") -> RadarDetections:
    """Decode N messages. Raises: MessageLayoutError (also for more detections than slots), ByteOrderError."""
    payloads = payloads_of(messages)
    plan = resolved(TYPE, schema).registry.plan(TYPE)
    stamps = np.empty((len(payloads), len(STAMPS)), np.int64)
    counts = np.zeros(len(payloads), np.int64)
    layouts: list[tuple[NDArray[np.int64], _Layout]] = []
    for rows in _alike(payloads):
        layout = _layout(payloads[rows[0]], plan)
        alike = [payloads[row] for row in rows]
        counts[rows], stamps[rows] = _counts(alike, layout), _stamps(alike, layout)
        layouts.append((np.array(rows, np.int64), layout))
    offsets = offsets_of(counts)
    columns = _gathered(payloads, layouts, offsets)
    columns["invalid"] = columns.pop("flags") & INVALID_MASK != 0
    return detections(joined_ns(stamps[:, 0], stamps[:, 1]), offsets, columns, joined_ns(stamps[:, 2], stamps[:, 3]))


def _alike(payloads: Sequence[memoryview]) -> Iterable[list[int]]:
    """Return rows of messages that share a layout."""
    by_key: dict[tuple[Any, ...], list[int]] = {}
    for row, payload in enumerate(payloads):
        key = (len(payload), *_KEY.unpack_from(payload)) if len(payload) >= _KEY.size else (len(payload),)
        by_key.setdefault(key, []).append(row)
    return by_key.values()


def _layout(payload: memoryview, plan: Sequence[Node]) -> _Layout:
    """Return the layout from the definition, so that a differing embedded one is followed."""
    pieces = {piece.node.name: piece for piece in sketched(payload, plan, TYPE).pieces}
    for name, code in CODES.items():
        node = pieces[name].node if name in pieces else None
        if not isinstance(node, Leaf) or node.code != np.dtype(code) or node.length is not None:
            raise MessageLayoutError(TYPE, f"its definition has no {name} of the type {code}")
    inside = {name: pieces[f"{PLACES}.{name}"] for name in FIELDS.values()}
    first_at = min(piece.offset for piece in inside.values())
    run = pieces[f"{PLACES}.s_rcs"].run
    is_alone = run is not None and (run.first, run.step) == (0, 1) and not any(piece.above for piece in inside.values())
    if run is None or not is_alone or first_at + run.elements * run.stride > len(payload):
        raise MessageLayoutError(TYPE, f"its definition declares {PLACES} with another layout")
    if max(pieces[name].offset + 4 for name in STAMPS) > first_at:
        raise MessageLayoutError(TYPE, f"its definition has stamps behind {PLACES}")
    stamps = _record({name: pieces[name] for name in STAMPS}, 0, first_at)
    return _Layout(stamps, pieces[COUNT].offset, first_at, run.elements, _record(inside, first_at, run.stride))


def _record(pieces: dict[str, PayloadPiece], start: int, size: int) -> np.dtype[np.void]:
    formats = [CODES.get(name, CODES.get(f"{PLACES}.{name}")) for name in pieces]
    offsets = [piece.offset - start for piece in pieces.values()]
    return np.dtype({"names": list(pieces), "formats": formats, "offsets": offsets, "itemsize": size})


def _counts(payloads: Sequence[memoryview], layout: _Layout) -> list[int]:
    unpack = Struct("<I").unpack_from
    counts = [unpack(payload, layout.count_at)[0] for payload in payloads]
    if max(counts) > layout.places:
        raise MessageLayoutError(TYPE, f"{COUNT} is {max(counts)}, the list has {layout.places} elements")
    return counts


def _stamps(payloads: Sequence[memoryview], layout: _Layout) -> NDArray[np.int64]:
    heads = np.frombuffer(b"".join([payload[: layout.first_at] for payload in payloads]), layout.stamps)
    return np.stack([heads[name].astype(np.int64) for name in STAMPS], axis=1)


def _gathered(
    payloads: Sequence[memoryview], layouts: Sequence[tuple[NDArray[np.int64], _Layout]], offsets: NDArray[np.int64]
) -> dict[str, NDArray[Any]]:
    """Return the columns of all detections, in the order of the messages."""
    columns: dict[str, NDArray[Any]] = {name: np.empty(offsets[-1], np.float32) for name in FIELDS}
    columns["flags"] = np.empty(offsets[-1], np.uint8)
    for rows, layout in layouts:
        start, size = layout.first_at, layout.detection.itemsize
        for batch in (rows[begin : begin + _BATCH] for begin in range(0, len(rows), _BATCH)):
            ends = start + (offsets[batch + 1] - offsets[batch]) * size
            parts = [payloads[row][start:end] for row, end in zip(batch.tolist(), ends.tolist(), strict=True)]
            table = np.frombuffer(b"".join(parts), layout.detection)
            places = _places(batch, offsets)
            for name, theirs in FIELDS.items():
                columns[name][places] = table[theirs]
    return columns


def _places(rows: NDArray[np.int64], offsets: NDArray[np.int64]) -> slice | NDArray[np.int64]:
    """Return the indices of the detections of `rows`: one slice unless messages of another layout lie between them."""
    if rows[-1] - rows[0] == len(rows) - 1:
        return slice(int(offsets[rows[0]]), int(offsets[rows[-1] + 1]))
    return np.concatenate([np.arange(offsets[row], offsets[row + 1]) for row in rows])
