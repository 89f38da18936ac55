"""Topics of a LiDAR's packets: taken for sweeps where they are decoded, and only where there are no points."""

from pathlib import Path

import numpy as np
import pytest

from services.ingest.pipeline import SynchroniseOptions, synchronise
from stone_recordings.report.inspection import inspect
from stone_recordings.sync.errors import NoLidarError
from tests.stone_recordings import rigs
from tests.stone_recordings.messages.lidars.encoding import SentPacket, nebula_packets, velodyne_scan
from tests.stone_recordings.rigs import PERIOD_NS, T0_NS, calibration, plain_sweep, written
from tests.stone_recordings.writing import Recorded

STAMPS_NS = T0_NS + np.arange(8) * PERIOD_NS
SCAN, NEBULA = "velodyne_msgs/msg/VelodyneScan", "nebula_msgs/msg/NebulaPackets"


def scan(stamp_ns: int, packets: int = 75) -> Recorded:
    """A turn of a VLP-16 in a round room of 10 m."""
    sent = [
        SentPacket("VLP-16", 1327 * number, [(480 * number + 40 * block) % 36_000 for block in range(12)],
                   np.full((12, 32), 5000)).content
        for number in range(packets)
    ]  # fmt: skip
    stamps_ns = [stamp_ns + 1_327_000 * number for number in range(packets)]
    return Recorded("/velodyne_packets", SCAN, stamp_ns + PERIOD_NS, velodyne_scan(sent, stamps_ns, stamp_ns))


def scans() -> list[Recorded]:
    return [scan(int(stamp)) for stamp in STAMPS_NS]


def odometry() -> list[Recorded]:
    stamps_ns = T0_NS + np.arange(-1, 19) * PERIOD_NS // 2
    return [rigs.odometry(int(stamp), rigs.world_from_ego(np.array([stamp]))[0]) for stamp in stamps_ns]


def codes(path: Path) -> list[tuple[str, str]]:
    return [(one.code, one.topic) for one in inspect(path).findings if not one.code.startswith("TIM-")]


def test_packets_are_a_lidar_and_are_said_to_be_packets(tmp_path: Path) -> None:
    path = written(tmp_path / "a.mcap", scans(), odometry())
    assert codes(path) == [("TOP-116", "/velodyne_packets")]
    inspection = inspect(path)
    assert inspection.assignment.channels["lidar"] == "/velodyne_packets"
    sequence, sweeps = synchronise(path, calibration(), SynchroniseOptions(), "run")
    assert len(sequence.frames) == 8
    assert "TOP-116" in {finding.code for finding in sequence.findings}
    assert "TOP-102" not in {finding.code for finding in sequence.findings}
    ranges_m = np.linalg.norm(sweeps.sweep(3).points_lidar, axis=1)
    assert len(ranges_m) == 75 * 12 * 32
    assert np.abs(ranges_m - 10.0).max() < 0.6  # the robot moves on at 4.8 m/s while the room is measured


def test_points_come_before_packets_unless_packets_are_asked_for(tmp_path: Path) -> None:
    clouds = [plain_sweep(int(stamp)) for stamp in STAMPS_NS]
    path = written(tmp_path / "a.mcap", scans(), clouds, odometry())
    assert inspect(path).assignment.channels["lidar"] == "/lidar_points"
    assert synchronise(path, calibration(), SynchroniseOptions(), "run")[1].topic == "/lidar_points"
    asked = SynchroniseOptions(lidar_topic="/velodyne_packets")
    assert synchronise(path, calibration(), asked, "run")[1].topic == "/velodyne_packets"


def test_a_message_whose_packets_are_of_something_else_costs_itself(tmp_path: Path) -> None:
    some = scans()
    at_ns = int(STAMPS_NS[2])
    strange = velodyne_scan([b"\xff\xee" + bytes(1203) + b"\x21"], [at_ns], at_ns)
    some[2] = Recorded("/velodyne_packets", SCAN, some[2].log_time_ns, strange)
    empty_ns = int(STAMPS_NS[5])
    some[5] = Recorded("/velodyne_packets", SCAN, some[5].log_time_ns, velodyne_scan([], [], empty_ns))
    path = written(tmp_path / "a.mcap", some, odometry())
    sequence, _ = synchronise(path, calibration(), SynchroniseOptions(), "run")
    assert [(one.stamp_ns, one.code) for one in sequence.excluded] == [
        (at_ns, "malformed_sweep"),
        (empty_ns, "empty_sweep"),
    ]
    assert "HDL-32E" in sequence.excluded[0].reason
    assert ("MSG-312", "/velodyne_packets") in codes(path)


def test_packets_that_are_not_decoded_are_refused_with_the_topic_to_record(tmp_path: Path) -> None:
    content = b"\xee\xff\x06\x01" + bytes(560)
    raw = [nebula_packets([content], [int(stamp)], int(stamp)) for stamp in STAMPS_NS]
    messages = [Recorded("/pandar", NEBULA, int(at), payload) for at, payload in zip(STAMPS_NS, raw, strict=True)]
    path = written(tmp_path / "a.mcap", messages, odometry())
    assert codes(path) == [("MSG-313", "/pandar"), ("TOP-101", "/pandar")]
    with pytest.raises(NoLidarError, match="/pandar holds raw packets: record the PointCloud2 topic of the driver"):
        synchronise(path, calibration(), SynchroniseOptions(), "run")


def test_ouster_packets_are_refused_with_the_topic_to_record(tmp_path: Path) -> None:
    kind = "ouster_sensor_msgs/msg/PacketMsg"
    raw = [Recorded("/ouster/lidar_packets", kind, int(at), b"\0\1\0\0" + bytes(64)) for at in STAMPS_NS]
    path = written(tmp_path / "a.mcap", raw, odometry())
    assert codes(path) == [("TOP-101", "/ouster/lidar_packets")]
    with pytest.raises(NoLidarError, match="/ouster/lidar_packets holds raw packets: record /ouster/points"):
        synchronise(path, calibration(), SynchroniseOptions(), "run")
