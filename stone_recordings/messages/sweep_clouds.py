"""The cloud of a sweep from whatever a driver recorded: sensor_msgs/PointCloud2, or the LiDAR's own packets.

**Conventions.** A message is one revolution. Packets are decoded with the maker's default angles of the model that they
name; of one message all are of the model of its first, and the others are left out.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone_recordings.bags.bag import Bag
from stone_recordings.bags.errors import ByteOrderError, MessageLayoutError
from stone_recordings.messages.lidars.hesai import ot128_returns, pandar40p_returns
from stone_recordings.messages.lidars.models import LidarModel, layout_of, model_of, refused
from stone_recordings.messages.lidars.packet_scan import PACKET_READERS, first_packet, packet_scan
from stone_recordings.messages.lidars.points import PacketReturns, records_of
from stone_recordings.messages.lidars.velodyne import velodyne_returns
from stone_recordings.messages.pointcloud2 import TYPE as POINT_CLOUD
from stone_recordings.messages.pointcloud2 import Cloud, decode_cloud, xyz_problem

PACKET_TYPES = frozenset(PACKET_READERS)
SWEEP_TYPES = PACKET_TYPES | {POINT_CLOUD}


@dataclass(frozen=True, eq=False)
class PacketCloud:
    """The cloud of one message of packets, the model, and how many of its packets are not of it."""

    cloud: Cloud
    model: LidarModel
    packets: int
    left_out: int


def cloud_at(bag: Bag, topic: str, index: int) -> Cloud:
    """The cloud of one message of a LiDAR's topic. Raises what reading it and `sweep_cloud` raise."""
    return sweep_cloud(bag.message(topic, index).payload, bag.type_of(topic))


def sweep_cloud(payload: memoryview, type_name: str) -> Cloud:
    """Raises: MessageLayoutError, ByteOrderError, CloudLayoutError, LidarPacketError (a model that is not decoded)."""
    return packet_cloud(payload, type_name).cloud if type_name in PACKET_TYPES else decode_cloud(payload)


def packet_cloud(payload: memoryview, type_name: str) -> PacketCloud:
    """Of a message of one of PACKET_TYPES. Raises: MessageLayoutError, ByteOrderError, LidarPacketError."""
    scan = packet_scan(payload, type_name)
    kinds = [(model, layout_of(one)) if (model := model_of(one)) else None for one in scan.packets]
    kind = next((one for one in kinds if one), None)
    if kind is None:
        raise refused(scan.packets[0] if scan.packets else memoryview(b""), type_name)
    rows = [row for row, one in enumerate(kinds) if one == kind]
    packets = [scan.packets[row] for row in rows]
    points = records_of(_returns(packets, kind[0], scan.stamps_ns[rows]), scan.stamp_ns)
    return PacketCloud(Cloud(scan.stamp_ns, scan.frame_id, points), kind[0], len(kinds), len(kinds) - len(rows))


def _returns(packets: list[memoryview], model: LidarModel, stamps_ns: NDArray[np.int64]) -> PacketReturns:
    if model == "Pandar40P":
        return pandar40p_returns(packets, stamps_ns)
    return ot128_returns(packets, stamps_ns) if model == "OT128" else velodyne_returns(packets, model, stamps_ns)


def sweep_problem(head: memoryview, type_name: str) -> str:
    """Why a message that begins so, and whose layout is right, holds no sweep; "" where nothing speaks against it."""
    return _packets_problem(head, type_name) if type_name in PACKET_TYPES else xyz_problem(head)


def _packets_problem(head: memoryview, type_name: str) -> str:
    try:
        packet = first_packet(head, type_name)
    except (MessageLayoutError, ByteOrderError) as error:
        return str(error)
    return "" if packet is None or model_of(packet) else str(refused(packet, type_name))
