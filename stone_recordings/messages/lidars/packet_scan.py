"""Messages with the original packets of a LiDAR: one message is one revolution.

**Conventions.** A packet's stamp is the one that its driver wrote beside it: the time of its arrival, or the sensor's
own. Source: velodyne_msgs, pandar_msgs, hesai_ros_driver and nebula_msgs (ROS 2).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone_recordings.bags.errors import ByteOrderError, MessageLayoutError
from stone_recordings.messages.types.cdr import Cursor

VELODYNE_SCAN, PANDAR_SCAN = "velodyne_msgs/msg/VelodyneScan", "pandar_msgs/msg/PandarScan"
HESAI_FRAME, NEBULA_PACKETS = "hesai_ros_driver/msg/UdpFrame", "nebula_msgs/msg/NebulaPackets"
VELODYNE_BYTES, PANDAR_BYTES = 1206, 1500
# Stamp and length: the least size of a packet of any of these types.
LEAST_PACKET_BYTES = 12
# In a revolution at 5 Hz an OT128 sends 3,600; decoding takes about 30 KB for each.
MOST_PACKETS = 10_000


@dataclass(frozen=True, eq=False)
class PacketScan:
    """`packets` (P) of one message and their `stamps_ns` (P,); `stamp_ns` is that of its header."""

    stamp_ns: int
    frame_id: str
    stamps_ns: NDArray[np.int64]
    packets: tuple[memoryview, ...]


def _velodyne(cursor: Cursor) -> memoryview:
    start = cursor.take(VELODYNE_BYTES)
    return cursor.payload[start : start + VELODYNE_BYTES]


def _pandar(cursor: Cursor) -> memoryview:
    """Return as many of the array's bytes as the size after it declares."""
    start = cursor.take(PANDAR_BYTES)
    return cursor.payload[start : start + min(cursor.u32(), PANDAR_BYTES)]


def _nebula(cursor: Cursor) -> memoryview:
    size = cursor.u32()
    start = cursor.take(size)
    return cursor.payload[start : start + size]


def _hesai(cursor: Cursor) -> memoryview:
    packet = _nebula(cursor)
    return packet[: cursor.u32()]


PACKET_READERS: Mapping[str, Callable[[Cursor], memoryview]] = {
    VELODYNE_SCAN: _velodyne,
    PANDAR_SCAN: _pandar,
    HESAI_FRAME: _hesai,
    NEBULA_PACKETS: _nebula,
}


def packet_scan(payload: memoryview, type_name: str) -> PacketScan:
    """Return the packets as views of `payload`. Raises: MessageLayoutError, ByteOrderError."""
    cursor = Cursor(payload, type_name)
    stamp_ns, frame_id = cursor.stamp_ns(), cursor.text()
    read = PACKET_READERS[type_name]
    count = cursor.count(LEAST_PACKET_BYTES)
    if count > MOST_PACKETS:
        raise MessageLayoutError(type_name, f"{count} packets in one scan, the limit is {MOST_PACKETS}")
    parts = [(cursor.stamp_ns(), read(cursor)) for _ in range(count)]
    cursor.end()
    return PacketScan(
        stamp_ns, frame_id, np.array([at for at, _ in parts], np.int64), tuple(packet for _, packet in parts)
    )


def first_packet(head: memoryview, type_name: str) -> memoryview | None:
    """Return the first packet of a message whose start is `head`; None without packets.

    Raises: MessageLayoutError, ByteOrderError.
    """
    cursor = Cursor(head, type_name)
    cursor.stamp_ns()
    cursor.text()
    if cursor.u32() == 0:
        return None
    cursor.stamp_ns()
    return PACKET_READERS[type_name](cursor)


def packet_count(head: memoryview, type_name: str) -> int:
    """Return the declared number of packets; 0 if the head cannot be read."""
    try:
        cursor = Cursor(head, type_name)
        cursor.stamp_ns()
        cursor.text()
        return cursor.u32()
    except (MessageLayoutError, ByteOrderError):
        return 0
