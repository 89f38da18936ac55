"""Fuzzing of LiDAR packets and of files of poses.

**Conventions.** For `packets` the first byte selects the message type; the rest is the message.
"""

import struct
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from stone_recordings.messages.lidars.packet_scan import HESAI_FRAME, NEBULA_PACKETS, PANDAR_SCAN, VELODYNE_SCAN
from stone_recordings.messages.pointcloud2 import lidar_points
from stone_recordings.messages.sweep_clouds import sweep_cloud, sweep_problem
from stone_recordings.poses.file_poses import read_pose_file

TYPES = (VELODYNE_SCAN, PANDAR_SCAN, NEBULA_PACKETS, HESAI_FRAME)
HEAD = b"\0\1\0\0" + struct.pack("<iII4s", 1_700_000_000, 0, 4, b"bag\0")


def read_packets(content: bytes) -> None:
    """Read the problem that the head reveals, and the points."""
    if content:
        payload, type_name = memoryview(content[1:]), TYPES[content[0] % len(TYPES)]
        sweep_problem(payload[:8192], type_name)
        lidar_points(sweep_cloud(payload, type_name))


def read_poses(content: bytes) -> None:
    if content:
        with TemporaryDirectory() as folder:
            path = Path(folder) / "poses.txt"
            path.write_bytes(content)
            read_pose_file(path)


def packet_seeds() -> Iterator[tuple[str, bytes]]:
    """Yield two packets of each model, in each message type that can contain them."""
    for name, packet in _packets().items():
        yield f"nebula-{name}", b"\2" + _message(packet, 4)
        yield f"hesai-{name}", b"\3" + _message(packet, 4, struct.pack("<I", len(packet)))
        if len(packet) == 1206:
            yield f"velodyne-{name}", b"\0" + _message(packet, 0)
        elif len(packet) <= 1500:
            yield f"pandar-{name}", b"\1" + _message(packet.ljust(1500, b"\0"), 0, struct.pack("<I", len(packet)))


def _packets() -> dict[str, bytes]:
    firing = b"\x10\x27\x64" * 32
    vlp = b"".join(b"\xff\xee" + struct.pack("<H", 20 * block) + firing for block in range(12))
    banks = (b"\xff\xee", b"\xff\xdd", b"\xff\xcc", b"\xff\xbb")
    vls = b"".join(banks[block % 4] + struct.pack("<H", block // 4) + firing for block in range(12))
    pandar = b"".join(b"\xff\xee" + struct.pack("<H", 20 * block) + b"\x10\x27\x64" * 40 for block in range(10))
    ot128 = b"\xee\xff\x01\x04\0\0\x80\x02\0\x04\x01\x04" + (b"\0\1" + b"\x10\x27\x64" * 128) * 2 + bytes(47)
    tails = {"VLP-16": b"\x37\x22", "VLP-16-dual": b"\x39\x22", "VLP-32C": b"\x37\x28"}
    packets = {name: vlp + bytes(4) + tail for name, tail in tails.items()}
    packets |= {"VLS-128": vls + bytes(4) + b"\x37\xa1", "Pandar40P": pandar + bytes(14) + b"\x39" + bytes(7)}
    return packets | {"OT128": ot128}


def _message(packet: bytes, length_bytes: int, tail: bytes = b"") -> bytes:
    content = bytearray(HEAD + struct.pack("<I", 2))
    for number in range(2):
        content += bytes(-len(content) % 4) + struct.pack("<iI", 1_700_000_000, 1_000_000 * number)
        content += struct.pack("<I", len(packet))[:length_bytes] + packet
        content += (bytes(-len(content) % 4) + tail) if tail else b""
    return bytes(content)


def pose_seeds() -> Iterator[tuple[str, bytes]]:
    yield "tum", b"# time x y z qx qy qz qw\n1700000000.1 1 2 3 0 0 0 1\n1700000000.2 1 2 3 0 0 0.6 0.8\n"
    yield "kitti", b"1 0 0 0.5 0 1 0 0 0 0 1 0\n" * 2
