"""The cloud of a sweep from any supported message: sensor_msgs/PointCloud2, plain or compressed, Livox's own message of
points, or the LiDAR's own packets.

**Conventions.** A message is one revolution. Packets are decoded with the maker's default angles of the model that they
name. All packets of a message are of the model of its first, and the others are left out.
"""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone_recordings.bags.bag import Bag
from stone_recordings.bags.errors import ByteOrderError, CloudLayoutError, MessageLayoutError
from stone_recordings.messages.compressed_cloud import compressed_problem, plain_cloud
from stone_recordings.messages.lidars.hesai import ot128_returns, pandar40p_returns
from stone_recordings.messages.lidars.livox import livox_cloud, livox_count, livox_problem
from stone_recordings.messages.lidars.models import (
    COMPRESSED_CLOUD,
    LIVOX_TYPES,
    LidarModel,
    layout_of,
    model_of,
    refused,
)
from stone_recordings.messages.lidars.packet_scan import PACKET_READERS, first_packet, packet_count, packet_scan
from stone_recordings.messages.lidars.points import PacketReturns, records_of
from stone_recordings.messages.lidars.velodyne import velodyne_returns
from stone_recordings.messages.pointcloud2 import TYPE as POINT_CLOUD
from stone_recordings.messages.pointcloud2 import Cloud, decode_cloud, layout_problem, points_of_head, xyz_problem
from stone_recordings.messages.types.cdr import Cursor

PACKET_TYPES = frozenset(PACKET_READERS)
CLOUD_TYPES = frozenset({POINT_CLOUD, COMPRESSED_CLOUD})
SWEEP_TYPES = PACKET_TYPES | CLOUD_TYPES | LIVOX_TYPES


@dataclass(frozen=True, eq=False)
class PacketCloud:
    """The cloud of one message of packets, the model, and the number of packets of other models."""

    cloud: Cloud
    model: LidarModel
    packets: int
    left_out: int


def cloud_at(bag: Bag, topic: str, index: int) -> Cloud:
    """Return the cloud of one message of a LiDAR's topic. Raises the errors of reading it and of `sweep_cloud`."""
    return sweep_cloud(bag.message(topic, index).payload, bag.type_of(topic))


def sweep_cloud(payload: memoryview, type_name: str) -> Cloud:
    """Decode a message. Raises: MessageLayoutError, ByteOrderError, CloudLayoutError, `MSG-330` and LidarPacketError
    (an unsupported compression or model).
    """
    if type_name in PACKET_TYPES:
        return packet_cloud(payload, type_name).cloud
    if type_name in LIVOX_TYPES:
        return livox_cloud(payload, type_name)
    return decode_cloud(plain_cloud(payload) if type_name == COMPRESSED_CLOUD else payload)


def points_declared(head: memoryview, type_name: str) -> int | None:
    """Return the points of a message with this head, or the packets that take their place.

    The bytes of a PointCloud2 decide; if the head does not hold all of its fields, the declared number counts. None if
    the head of a cloud cannot be read, 0 if that of another message cannot.
    """
    if type_name in PACKET_TYPES:
        return packet_count(head, type_name)
    if type_name in LIVOX_TYPES:
        return livox_count(head, type_name)
    with suppress(MessageLayoutError, ByteOrderError, CloudLayoutError):
        if type_name == POINT_CLOUD:
            return points_of_head(head)
    try:
        cursor = Cursor(head, type_name)
        cursor.stamp_ns()
        cursor.text()
        return cursor.u32() * cursor.u32()
    except (MessageLayoutError, ByteOrderError):
        return None


def points_problem(head: memoryview, type_name: str, size_bytes: Callable[[], int]) -> str:
    """Return why a message of points with this head cannot be decoded; "" for other types, and if the head is valid.

    `size_bytes` returns the size of the whole message; `head` may be all of it.
    """
    if type_name == POINT_CLOUD:
        return layout_problem(head, size_bytes)
    if type_name == COMPRESSED_CLOUD:
        return compressed_problem(head, size_bytes)
    return livox_problem(head, type_name, size_bytes) if type_name in LIVOX_TYPES else ""


def packet_cloud(payload: memoryview, type_name: str) -> PacketCloud:
    """Decode a message of one of PACKET_TYPES. Raises: MessageLayoutError, ByteOrderError, LidarPacketError."""
    scan = packet_scan(payload, type_name)
    kinds = [(model, layout_of(packet)) if (model := model_of(packet)) else None for packet in scan.packets]
    kind = next((packet for packet in kinds if packet), None)
    if kind is None:
        raise refused(scan.packets[0] if scan.packets else memoryview(b""), type_name)
    rows = [row for row, packet in enumerate(kinds) if packet == kind]
    packets = [scan.packets[row] for row in rows]
    points = records_of(_returns(packets, kind[0], scan.stamps_ns[rows]), scan.stamp_ns)
    return PacketCloud(Cloud(scan.stamp_ns, scan.frame_id, points), kind[0], len(kinds), len(kinds) - len(rows))


def _returns(packets: list[memoryview], model: LidarModel, stamps_ns: NDArray[np.int64]) -> PacketReturns:
    if model == "Pandar40P":
        return pandar40p_returns(packets, stamps_ns)
    return ot128_returns(packets, stamps_ns) if model == "OT128" else velodyne_returns(packets, model, stamps_ns)


def sweep_problem(head: memoryview, type_name: str) -> str:
    """Return why a message with this head and a valid layout holds no sweep; "" if it may hold one."""
    if type_name in PACKET_TYPES:
        return _packets_problem(head, type_name)
    return xyz_problem(head, is_compressed=type_name == COMPRESSED_CLOUD) if type_name in CLOUD_TYPES else ""


def _packets_problem(head: memoryview, type_name: str) -> str:
    try:
        packet = first_packet(head, type_name)
    except (MessageLayoutError, ByteOrderError) as error:
        return str(error)
    return "" if packet is None or model_of(packet) else str(refused(packet, type_name))
