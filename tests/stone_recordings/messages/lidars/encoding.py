"""Packets as LiDARs send them, and what they mean point by point: the slow, obvious way, with loops and the manuals'
own formulas."""

import struct
from dataclasses import dataclass
from math import cos, radians, sin

import numpy as np
from numpy.typing import NDArray

from stone_recordings.messages.lidars.models import LidarModel
from stone_recordings.messages.lidars.points import AZIMUTH_DEG, ELEVATION_DEG, OT128_FIRING_NS, PANDAR40P_FIRING_NS
from tests.stone_recordings.writing import header, made, serialised

PRODUCTS = {"VLP-16": 0x22, "VLP-32C": 0x28, "VLS-128": 0xA1}
UNITS_M = {"VLP-16": 0.002, "VLP-32C": 0.004, "VLS-128": 0.004, "Pandar40P": 0.004, "OT128": 0.004}
BLOCKS = {"VLP-16": 12, "VLP-32C": 12, "VLS-128": 12, "Pandar40P": 10, "OT128": 2}
LASERS = {"VLP-16": 32, "VLP-32C": 32, "VLS-128": 32, "Pandar40P": 40, "OT128": 128}
BANKS = (0xEEFF, 0xDDFF, 0xCCFF, 0xBBFF)
SINGLE, DUAL = 0x37, 0x39


@dataclass(frozen=True, eq=False)
class SentPacket:
    """What a packet says: `azimuth` (blocks,) in 0.01°, `counts` (blocks, lasers) in steps of range."""

    model: LidarModel
    time_us: int
    azimuth: list[int]
    counts: NDArray[np.int64]
    mode: int = SINGLE

    @property
    def content(self) -> bytes:
        if self.model in PRODUCTS:
            tail = struct.pack("<IBB", self.time_us, self.mode, PRODUCTS[self.model])
            return b"".join(self._block(block) for block in range(12)) + tail
        if self.model == "Pandar40P":
            tail = struct.pack("<5xB2xHIBB6B", 0, 600, self.time_us, self.mode, 0x42, 26, 11, 26, 12, 0, 0)
            return b"".join(self._block(block) for block in range(10)) + tail
        head = b"\xee\xff\x01\x04\0\0\x80\x02\0\x04\x01\x04"
        tail = struct.pack("<4x17x12xBH6BIB", self.mode, 600, 126, 11, 26, 12, 0, 0, self.time_us, 0x42)
        return head + self._block(0) + self._block(1) + tail

    def _block(self, block: int) -> bytes:
        bank = {"VLS-128": BANKS[block // self.echoes % 4], "OT128": None}.get(self.model, BANKS[0])
        start = b"" if bank is None else struct.pack("<H", bank)
        returns = b"".join(struct.pack("<HB", int(count), 100) for count in self.counts[block])
        return start + struct.pack("<H", self.azimuth[block]) + returns

    @property
    def echoes(self) -> int:
        return 2 if self.mode == DUAL else 1


def meant(packet: SentPacket, step: int) -> list[tuple[float, float, float, float]]:
    """x, y, z in metres and the time in µs of every return, where every sequence turns by `step` hundredths."""
    found = []
    for block in range(BLOCKS[packet.model]):
        for laser in range(LASERS[packet.model]):
            count = int(packet.counts[block, laser])
            if count:
                found.append(_point(packet, (block, laser), step, count * UNITS_M[packet.model]))
    return found


def _point(packet: SentPacket, place: tuple[int, int], step: int, range_m: float) -> tuple[float, float, float, float]:
    block, laser = place
    model, pulse = packet.model, block // packet.echoes
    if model in PRODUCTS:
        number, into_us, cycle_us, sequence = _velodyne(model, pulse, laser)
        time_us = packet.time_us + sequence * cycle_us + into_us
        angle = packet.azimuth[block] / 100 + step / 100 * into_us / cycle_us + AZIMUTH_DEG[model][number]
        flat, up = range_m * cos(radians(ELEVATION_DEG[model][number])), radians(ELEVATION_DEG[model][number])
        return flat * cos(radians(angle)), -flat * sin(radians(angle)), range_m * sin(up), time_us
    last = BLOCKS[model] // packet.echoes - 1 - pulse
    if model == "Pandar40P":
        time_us = packet.time_us - 28.58 - 55.56 * last + PANDAR40P_FIRING_NS[laser] / 1000
    else:
        time_us = packet.time_us + 43.346 - 55.556 * last + OT128_FIRING_NS[laser] / 1000
    angle, up = radians(packet.azimuth[block] / 100 + AZIMUTH_DEG[model][laser]), radians(ELEVATION_DEG[model][laser])
    return range_m * cos(up) * sin(angle), range_m * cos(up) * cos(angle), range_m * sin(up), time_us


def _velodyne(model: str, pulse: int, laser: int) -> tuple[int, float, float, int]:
    """Number of the laser, µs into its sequence, µs of a sequence, and which one of the packet."""
    if model == "VLP-16":
        return laser % 16, laser // 16 * 55.296 + laser % 16 * 2.304, 110.592, pulse
    if model == "VLP-32C":
        return laser, laser // 2 * 2.304, 55.296, pulse
    number = 32 * (pulse % 4) + laser
    return number, (number // 8 + number // 64) * 2.665 - 8.7, 53.3, pulse // 4


def velodyne_scan(packets: list[bytes], stamps_ns: list[int], stamp_ns: int) -> bytes:
    parts = [
        made("velodyne_msgs/msg/VelodynePacket", stamp=header(at, "").stamp, data=np.frombuffer(one, np.uint8))
        for one, at in zip(packets, stamps_ns, strict=True)
    ]
    return serialised(made("velodyne_msgs/msg/VelodyneScan", header=header(stamp_ns, "velodyne"), packets=parts))


def pandar_scan(packets: list[bytes], stamps_ns: list[int], stamp_ns: int) -> bytes:
    parts = [
        made("pandar_msgs/msg/PandarPacket", stamp=header(at, "").stamp, size=len(one),
             data=np.frombuffer(one.ljust(1500, b"\0"), np.uint8))
        for one, at in zip(packets, stamps_ns, strict=True)
    ]  # fmt: skip
    return serialised(made("pandar_msgs/msg/PandarScan", header=header(stamp_ns, "pandar"), packets=parts))


def nebula_packets(packets: list[bytes], stamps_ns: list[int], stamp_ns: int) -> bytes:
    parts = [
        made("nebula_msgs/msg/NebulaPacket", stamp=header(at, "").stamp, data=np.frombuffer(one, np.uint8))
        for one, at in zip(packets, stamps_ns, strict=True)
    ]
    return serialised(made("nebula_msgs/msg/NebulaPackets", header=header(stamp_ns, "hesai"), packets=parts))


def udp_frame(packets: list[bytes], stamps_ns: list[int], stamp_ns: int) -> bytes:
    parts = [
        made("hesai_ros_driver/msg/UdpPacket", stamp=header(at, "").stamp, size=len(one),
             data=np.frombuffer(one, np.uint8))
        for one, at in zip(packets, stamps_ns, strict=True)
    ]  # fmt: skip
    return serialised(made("hesai_ros_driver/msg/UdpFrame", header=header(stamp_ns, "hesai"), packets=parts))
