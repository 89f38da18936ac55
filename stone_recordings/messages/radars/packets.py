"""nebula_msgs/msg/NebulaPackets of an ARS 548: the radar's original SOME/IP packets.

**Conventions.** Packets are big-endian without padding. Only detection lists are read; object lists and status messages
are skipped. A message is a scan: without a detection list it has no detections, and its sensor stamp is 0. Source: ARS
548 RDI interface (method 336), as laid out in tier4/nebula.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stone_recordings.bags.errors import IngestError, MessageLayoutError
from stone_recordings.messages.batch import StampedMessage
from stone_recordings.messages.radars.detections import (
    INVALID_MASK,
    RadarDetections,
    detections,
    joined_ns,
    offsets_of,
)
from stone_recordings.messages.types.registry import resolved
from stone_recordings.messages.types.table import Ragged, decode_table

TYPE = "nebula_msgs/msg/NebulaPackets"
DETECTION_METHOD = 336
HEADER = np.dtype([("service_id", ">u2"), ("method_id", ">u2"), ("length", ">u4")])
PLACES = 800
DETECTION = np.dtype(
    [
        ("azimuth_angle", ">f4"), ("azimuth_angle_std", ">f4"), ("invalid_flags", "u1"), ("elevation_angle", ">f4"),
        ("elevation_angle_std", ">f4"), ("range", ">f4"), ("range_std", ">f4"), ("range_rate", ">f4"),
        ("range_rate_std", ">f4"), ("rcs", "i1"), ("measurement_id", ">u2"), ("positive_predictive_value", "u1"),
        ("classification", "u1"), ("multi_target_probability", "u1"), ("object_id", ">u2"), ("ambiguity_flag", "u1"),
        ("sort_index", ">u2"),
    ]
)  # fmt: skip
_ORIGIN = [(f"origin_{axis}{kind}", ">f4") for axis in ("x", "y", "z", "roll", "pitch", "yaw") for kind in ("", "_std")]
DETECTION_LIST = np.dtype(
    [
        ("service_id", ">u2"), ("method_id", ">u2"), ("length", ">u4"), ("client_id", ">u2"), ("session_id", ">u2"),
        ("protocol_version", "u1"), ("interface_version", "u1"), ("message_type", "u1"), ("return_code", "u1"),
        ("crc", ">u8"), ("e2e_length", ">u4"), ("sequence_counter", ">u4"), ("data_id", ">u4"),
        ("timestamp_nanoseconds", ">u4"), ("timestamp_seconds", ">u4"), ("timestamp_sync_status", "u1"),
        ("event_data_qualifier", ">u4"), ("extended_qualifier", "u1"), ("origin_invalid_flags", ">u2"),
        *_ORIGIN,
        ("list_invalid_flags", "u1"), ("detections", DETECTION, PLACES), ("velocity_min", ">f4"),
        ("velocity_max", ">f4"), ("number_of_detections", ">u4"), ("azimuth_correction", ">f4"),
        ("elevation_correction", ">f4"), ("alignment_status", "u1"), ("reserved", "u1", 14),
    ]
)  # fmt: skip


class DetectionLists(NamedTuple):
    """K detection lists, whole, and the message of each."""

    stamps_ns: NDArray[np.int64]
    rows: NDArray[np.int64]
    lists: NDArray[np.void]


def decode_packets(messages: Iterable[StampedMessage], schema: str = "") -> RadarDetections:
    """Decode N messages. Raises: MessageLayoutError, ByteOrderError, `MSG-308` (a detection list of another size, or
    with more detections than slots).
    """
    read = detection_lists(messages, schema)
    counts_of_lists = read.lists["number_of_detections"].astype(np.int64)
    counts = np.bincount(read.rows, counts_of_lists, len(read.stamps_ns)).astype(np.int64)
    is_used = np.arange(PLACES) < counts_of_lists[:, None]
    used = read.lists["detections"][is_used]
    columns = {name: used[theirs] for name, theirs in _COLUMNS.items()}
    columns["invalid"] = used["invalid_flags"] & INVALID_MASK != 0
    own = np.zeros(len(read.stamps_ns), np.int64)
    # Lists of one message are written from the last to the first, so that the first stays.
    own[read.rows[::-1]] = joined_ns(read.lists["timestamp_seconds"], read.lists["timestamp_nanoseconds"])[::-1]
    return detections(read.stamps_ns, offsets_of(counts), columns, own)


_COLUMNS = {
    "azimuth": "azimuth_angle", "elevation": "elevation_angle", "range": "range", "range_rate": "range_rate",
    "rcs": "rcs",
}  # fmt: skip


def detection_lists(messages: Iterable[StampedMessage], schema: str = "") -> DetectionLists:
    """Return every field of every detection list; raises the errors of `decode_packets`."""
    table = decode_table(TYPE, messages, resolved(TYPE, schema).registry)
    packets = table.columns.get("packets.data")
    if not isinstance(packets, Ragged) or not isinstance(packets.values, Ragged):
        raise MessageLayoutError(TYPE, "its definition does not declare packets.data as packets of bytes")
    offsets, content = packets.values.offsets, packets.values.values
    if not isinstance(content, np.ndarray) or content.dtype != np.uint8 or content.ndim != 1:
        raise MessageLayoutError(TYPE, "its definition does not declare packets.data as bytes")
    rows = np.repeat(np.arange(table.count), np.diff(packets.offsets))
    ours = _detection_packets(offsets, content)
    raw = [content[offsets[index] : offsets[index + 1]] for index in ours]
    lists = np.frombuffer(b"".join(part.tobytes() for part in raw), DETECTION_LIST)
    if len(lists) and lists["number_of_detections"].max() > PLACES:
        raise packet_refusal(
            f"{lists['number_of_detections'].max()} detections are declared, a list has {PLACES} elements"
        )
    return DetectionLists(table.stamps_ns(), rows[ours], lists)


def _detection_packets(offsets: NDArray[np.int64], content: NDArray[np.uint8]) -> Sequence[int]:
    """Return the indices of the packets that are detection lists, by their SOME/IP header."""
    sizes = np.diff(offsets)
    heads = [
        np.frombuffer(content[start : start + HEADER.itemsize].tobytes(), HEADER)[0] if size >= 8 else None
        for start, size in zip(offsets[:-1].tolist(), sizes.tolist(), strict=True)
    ]
    ours = []
    for index, head in enumerate(heads):
        if head is None or head["service_id"] != 0 or head["method_id"] != DETECTION_METHOD:
            continue
        if sizes[index] != DETECTION_LIST.itemsize or head["length"] != DETECTION_LIST.itemsize - HEADER.itemsize:
            raise packet_refusal(
                f"a detection list of {sizes[index]} bytes declares {head['length']}; it has {DETECTION_LIST.itemsize}"
            )
        ours.append(index)
    return ours


def packet_refusal(problem: str) -> IngestError:
    return IngestError(
        "MSG-308", f"nebula_msgs/msg/NebulaPackets: {problem}; the packet is damaged or of another sensor"
    )
